"""The figure of each type of object, by its method `plot`, and its view in a notebook.

| type | figure | options |
|---|---|---|
| `TetMesh` | surface, seen from a corner | `values`, `label` |
| `Recording` | displacement and force of presses; forces by a probe over the surface | |
| `Phantom` | slices of Young's modulus | `point_mm` |
| `Reconstruction` | slices of the result | those of `reconstruction_figure` |
| `ShapeReconstruction` | slices of the inclusions | `point_mm` |
"""

import base64
import html
import io
from functools import singledispatch
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from tactorch.display import Displayed
from tactorch.inverse import Reconstruction, ShapeReconstruction
from tactorch.mesh import TetMesh
from tactorch.phantoms import Phantom
from tactorch.recording import Recording
from tactorch.viz.field import field_figure
from tactorch.viz.palpation import palpation_figure
from tactorch.viz.reconstruction import reconstruction_figure
from tactorch.viz.session import presses_figure
from tactorch.viz.surface import surface_figure

_DPI = 80  # of pictures in notebooks


@singledispatch
def make_figure(thing: object, **options: Any) -> Figure:
    """Return the figure of an object.

    Raises:
        TypeError: the object is of no type with a figure.
    """
    raise TypeError(f"{type(thing).__name__} has no figure.")


make_figure.register(TetMesh, surface_figure)
make_figure.register(Reconstruction, reconstruction_figure)


@make_figure.register(Recording)
def _(recording: Recording, **options: Any) -> Figure:
    if recording.has_probes:
        return palpation_figure(recording, **options)
    return presses_figure(recording, **options)


@make_figure.register(Phantom)
def _(phantom: Phantom, *, point_mm: Float[np.ndarray, "3"] | None = None) -> Figure:
    low, high = np.array(phantom.body.bounds())
    if point_mm is None:
        shapes = [shape for shape, _ in phantom.inclusions]
        bounds = np.array(shapes[0].bounds()) if shapes else np.array([low, high])
        point_mm = bounds.mean(axis=0)
    return field_figure(phantom.youngs_at, (low, high), point_mm, phantom.body.contains)


@make_figure.register(ShapeReconstruction)
def _(shapes: ShapeReconstruction, *, point_mm: Float[np.ndarray, "3"] | None = None) -> Figure:
    low, high = shapes.field.prior.low_mm, shapes.field.prior.high_mm
    if point_mm is None:
        found = shapes.inclusions
        point_mm = np.array(found[0].shape.center_mm) if found else 0.5 * (low + high)
    return field_figure(shapes.youngs_at, (low, high), point_mm)


def make_html(thing: Displayed) -> str:
    """Return summary and figure of an object as HTML."""
    buffer = io.BytesIO()
    make_figure(thing).savefig(buffer, dpi=_DPI, format="png")
    picture = base64.b64encode(buffer.getvalue()).decode()
    name, text = type(thing).__name__, html.escape(thing.summary())
    return (
        f"<div><strong>{name}</strong><pre>{text}</pre>"
        f'<img alt="{name}" style="max-width:100%" src="data:image/png;base64,{picture}"></div>'
    )

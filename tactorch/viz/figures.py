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
from collections.abc import Callable
from functools import singledispatch
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from tactorch.display import Displayed
from tactorch.errors import ConfigError
from tactorch.inverse import Reconstruction, ShapeReconstruction
from tactorch.mesh import TetMesh
from tactorch.phantoms import Phantom
from tactorch.recording import Recording
from tactorch.viz.figure import MODULUS_LABEL, new_figure, new_grid
from tactorch.viz.presses import palpation_figure, presses_figure
from tactorch.viz.reconstruction import reconstruction_figure
from tactorch.viz.slicing import Plane, colour_scale

_DPI = 80  # of pictures in notebooks
_PANEL_INCHES = 3.1
_PIXELS = 120  # along the longest side
_LIGHT = np.array([0.4, -0.5, 0.77])

Values = Callable[[Float[np.ndarray, "k 3"]], Float[np.ndarray, " k"]]
Inside = Callable[[Float[np.ndarray, "k 3"]], Bool[np.ndarray, " k"]]


@singledispatch
def make_figure(thing: object, **options: Any) -> Figure:
    """Return the figure of an object.

    Raises:
        TypeError: the object is of no type with a figure.
    """
    raise TypeError(f"{type(thing).__name__} has no figure.")


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
    return _field_figure(phantom.youngs_at, (low, high), point_mm, phantom.body.contains)


@make_figure.register(ShapeReconstruction)
def _(shapes: ShapeReconstruction, *, point_mm: Float[np.ndarray, "3"] | None = None) -> Figure:
    low, high = shapes.field.prior.low_mm, shapes.field.prior.high_mm
    if point_mm is None:
        found = shapes.inclusions
        point_mm = found[0].shape.centroid_mm if found else 0.5 * (low + high)
    return _field_figure(shapes.youngs_at, (low, high), point_mm)


def _field_figure(
    youngs_at: Values,
    bounds_mm: tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]],
    point_mm: Float[np.ndarray, "3"],
    inside: Inside | None = None,
) -> Figure:
    """Return a figure of slices across x, y and z through a point.

    Args:
        youngs_at: Young's modulus at points (mm), MPa.
        bounds_mm: Lowest and highest corner of the body's bounding box.
        point_mm: Point that the slices have in common.
        inside: Whether points (mm) are inside the body; by default all are.
    """
    bounds = np.stack(bounds_mm)
    planes = [Plane.through(bounds, axis, point_mm[axis], _PIXELS) for axis in range(3)]
    fields = []
    for plane in planes:
        points = plane.points.reshape(-1, 3)
        values = np.ma.masked_array(youngs_at(points), inside is not None and ~inside(points))
        fields.append(values.reshape(plane.points.shape[:2]))
    known = np.concatenate([field.compressed() for field in fields])
    norm = colour_scale({"reconstruction": known}, "linear", None)
    figure, grid = new_grid(3 * _PANEL_INCHES + 1.0, _PANEL_INCHES, 1, 3)
    for axes, plane, field in zip(grid[0], planes, fields, strict=True):
        plane.show(axes, field, cmap="viridis", norm=norm)
        plane.label(axes)
    figure.colorbar(ScalarMappable(norm, "viridis"), ax=grid, label=MODULUS_LABEL, shrink=0.8)
    return figure


@make_figure.register(TetMesh)
def surface_figure(
    mesh: TetMesh, *, values: Float[np.ndarray, " m"] | None = None, label: str = ""
) -> Figure:
    """Return a figure of the surface of a mesh, seen from a corner.

    Args:
        mesh: The mesh.
        values: Value of each element, shown as colour; by default the region, if there are any.
        label: Label of the values.

    Raises:
        ConfigError: there is not one value for each element.
    """
    if values is None and mesh.regions is not None:
        values, label = mesh.regions.astype(float), label or "region"
    if values is not None and len(values) != mesh.n_tets:
        raise ConfigError(f"values: {len(values)} for {mesh.n_tets} elements; give one each.")
    surface, figure = mesh.surface, new_figure(5.0, 4.2)
    axes: Axes3D = figure.add_subplot(projection="3d")
    faces = Poly3DCollection(mesh.points[surface.triangles], linewidths=0.25, edgecolors="0.3")
    shade = 0.55 + 0.45 * np.clip(surface.normals @ _LIGHT, 0.0, 1.0)
    colours = np.full((len(shade), 4), (0.72, 0.78, 0.85, 1.0))
    if values is not None:
        norm = Normalize(float(values.min()), float(values.max()))
        scale = ScalarMappable(norm, "viridis")
        colours = scale.to_rgba(values[surface.owners])
        figure.colorbar(scale, ax=axes, label=label, shrink=0.7, pad=0.12)
    colours[:, :3] *= shade[:, None]
    faces.set_facecolor(colours)
    axes.add_collection3d(faces)
    low, high = mesh.bounds
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(tuple(high - low))
    axes.set(xlabel="x (mm)", ylabel="y (mm)", zlabel="z (mm)")
    return figure


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

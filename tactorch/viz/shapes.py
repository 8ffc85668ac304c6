"""Slices of a map and of the shapes that were fitted to the same presses."""

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure

from tactorch.errors import TactorchError
from tactorch.inverse.shapes import ShapeReconstruction
from tactorch.mesh import TetMesh
from tactorch.viz.figure import MODULUS_LABEL, new_grid
from tactorch.viz.slicing import AXES, IN_PLANE, Slice, colour_scale, slices_at

_PANEL_INCHES = 2.3
_NAMES = {"map": "map by element", "shapes": "shapes", "truth": "truth by element"}
_PIXELS = 160


def shape_figure(
    mesh: TetMesh,
    shapes: ShapeReconstruction,
    *,
    youngs: Float[np.ndarray, " m"] | None = None,
    truth: Float[np.ndarray, " m"] | None = None,
    cmap: str = "viridis",
) -> Figure:
    """Return a figure of slices through the most certain inclusion, or the centre of the body.

    Args:
        mesh: Mesh of the body, mm.
        shapes: Result of `find_shapes`. Its boundaries are sharp, between elements too.
        youngs: Map of the same presses, MPa (m,), as a separate row.
        truth: True modulus of each element, MPa (m,), likewise.
        cmap: Name of a matplotlib colour map.

    Raises:
        TactorchError: values do not match the mesh.
    """
    rows = {"map": youngs, "shapes": None, "truth": truth}
    for name, values in rows.items():
        if values is not None and values.shape != (mesh.n_tets,):
            raise TactorchError(
                f"{name}: shape {values.shape} for a mesh of {mesh.n_tets} tetrahedra."
            )
    shown = [name for name, values in rows.items() if name == "shapes" or values is not None]
    center = np.mean(mesh.bounds, axis=0)
    if shapes.inclusions:
        center = np.array(shapes.inclusions[0].shape.center_mm)
    slices = slices_at(mesh, center, _PIXELS)
    fields = [_field(piece, shapes) for piece in slices]
    scaled = {"reconstruction": np.concatenate([field.compressed() for field in fields])}
    scaled |= {} if truth is None else {"truth": truth}
    norm = colour_scale(scaled, "linear", None)
    figure, grid = new_grid(3 * _PANEL_INCHES + 1.0, len(shown) * _PANEL_INCHES, len(shown), 3)
    for name, row in zip(shown, grid, strict=True):
        values = rows[name]
        for piece, field, axes in zip(slices, fields, row, strict=True):
            pixels = field if values is None else piece.values(values)
            axes.imshow(
                pixels, extent=piece.extent_mm, origin="lower", interpolation="nearest",
                cmap=cmap, norm=norm,
            )  # fmt: skip
            _label(axes, piece, name, first=axes is row[0], last=name == shown[-1])
    figure.colorbar(ScalarMappable(norm, cmap), ax=grid, label=MODULUS_LABEL, shrink=0.8)
    return figure


def _field(piece: Slice, shapes: ShapeReconstruction) -> Float[np.ma.MaskedArray, "r c"]:
    """Modulus of the shapes at the pixels of a slice, masked outside the body."""
    across, up = IN_PLANE[piece.axis]
    horizontal, vertical = piece.centres_mm()
    points = np.empty((len(vertical), len(horizontal), 3))
    points[..., piece.axis] = piece.position_mm
    points[..., across], points[..., up] = horizontal, vertical[:, None]
    values = shapes.youngs_at(points.reshape(-1, 3)).reshape(points.shape[:2])
    return np.ma.masked_where(piece.elements < 0, values)


def _label(axes: Axes, piece: Slice, name: str, *, first: bool, last: bool) -> None:
    across, up = IN_PLANE[piece.axis]
    axes.set_title(f"{AXES[piece.axis]} = {piece.position_mm:.2f} mm", fontsize=8)
    axes.tick_params(labelsize=7)
    if last:
        axes.set_xlabel(f"{AXES[across]} (mm)", fontsize=8)
    prefix = f"{_NAMES[name]}\n" if first else ""
    axes.set_ylabel(f"{prefix}{AXES[up]} (mm)", fontsize=8)

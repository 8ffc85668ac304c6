"""Figure of slices through a modulus that is a function of the position."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure

from tactorch.viz.figure import MODULUS_LABEL, new_grid
from tactorch.viz.slicing import Plane, colour_scale

_PANEL_INCHES = 3.1
_PIXELS = 120  # along the longest side

Values = Callable[[Float[np.ndarray, "k 3"]], Float[np.ndarray, " k"]]
Inside = Callable[[Float[np.ndarray, "k 3"]], Bool[np.ndarray, " k"]]


def field_figure(
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

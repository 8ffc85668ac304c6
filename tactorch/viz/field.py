"""Figure of slices through a modulus that is a function of the position."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure

from tactorch.viz.figure import MODULUS_LABEL, new_grid
from tactorch.viz.slicing import AXES, IN_PLANE, colour_scale

_PANEL_INCHES = 3.1
_PIXELS = 120  # along the longest side

Values = Callable[[Float[np.ndarray, "k 3"]], Float[np.ndarray, " k"]]
Inside = Callable[[Float[np.ndarray, "k 3"]], Bool[np.ndarray, " k"]]


def field_figure(
    youngs_at: Values,
    bounds_mm: tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]],
    point_mm: Float[np.ndarray, "3"],
    inside: Inside | None = None,
    *,
    cmap: str = "viridis",
) -> Figure:
    """Return a figure of slices across x, y and z through a point.

    Args:
        youngs_at: Young's modulus at points (mm), MPa.
        bounds_mm: Lowest and highest corner of the body's bounding box.
        point_mm: Point that the slices have in common.
        inside: Whether points (mm) are inside the body; by default all are.
        cmap: Name of a matplotlib colour map.
    """
    low, high = bounds_mm
    slices = [_points(low, high, axis, float(point_mm[axis])) for axis in range(3)]
    flat = np.concatenate([points.reshape(-1, 3) for points in slices])
    values = np.ma.masked_array(youngs_at(flat), inside is not None and ~inside(flat))
    norm = colour_scale({"reconstruction": values.compressed()}, "linear", None)
    figure, grid = new_grid(3 * _PANEL_INCHES + 1.0, _PANEL_INCHES, 1, 3)
    parts = np.split(
        np.arange(len(flat)), np.cumsum([points[..., 0].size for points in slices])[:-1]
    )
    for axis, (axes, points, part) in enumerate(zip(grid[0], slices, parts, strict=True)):
        across, up = IN_PLANE[axis]
        axes.imshow(
            values[part].reshape(points.shape[:2]), origin="lower", cmap=cmap, norm=norm,
            extent=(low[across], high[across], low[up], high[up]),
        )  # fmt: skip
        axes.set_xlabel(f"{AXES[across]} (mm)")
        axes.set_ylabel(f"{AXES[up]} (mm)")
        axes.set_title(f"{AXES[axis]} = {point_mm[axis]:.3g} mm", fontsize=9)
    figure.colorbar(ScalarMappable(norm, cmap), ax=grid, label=MODULUS_LABEL, shrink=0.8)
    return figure


def _points(
    low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"], axis: int, position_mm: float
) -> Float[np.ndarray, "rows columns 3"]:
    """Return the centres of the pixels of a slice, the lowest row first."""
    across, up = IN_PLANE[axis]
    pixel = float((high - low).max()) / _PIXELS
    counts = np.maximum(np.round((high - low) / pixel).astype(int), 2)
    lines = [
        low[a] + (np.arange(counts[a]) + 0.5) * (high[a] - low[a]) / counts[a] for a in range(3)
    ]
    points = np.empty((counts[up], counts[across], 3))
    points[..., axis] = position_mm
    points[..., across] = lines[across]
    points[..., up] = lines[up][:, None]
    return points

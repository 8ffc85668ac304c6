"""Plane slices through a mesh on square pixels, and the colour scale that they share."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.image import AxesImage

from tactorch.errors import ConfigError
from tactorch.mesh import TetMesh
from tactorch.mesh.locate import locate

AXES = "xyz"
#: Axes along the horizontal and the vertical of a picture, for slices across x, y and z.
IN_PLANE = ((1, 2), (0, 2), (0, 1))
# Planes through the nodes of a regular mesh would show elements of both sides alternately; an
# offset by this fraction of the diagonal selects one side.
_NUDGE = 1e-6
# Elements above this multiple of the 99.5th percentile do not extend the colour scale.
_OUTLIER_FACTOR = 4.0


@dataclass(frozen=True, eq=False)
class Slice:
    """One plane slice.

    Attributes:
        axis: Axis normal to the plane: 0, 1 or 2.
        position_mm: Coordinate of the plane along that axis, mm.
        elements: Tetrahedron under each pixel, -1 outside; row 0 is the lowest.
        extent_mm: Left, right, bottom and top of the picture, mm.
    """

    axis: int
    position_mm: float
    elements: Int[np.ndarray, "rows columns"]
    extent_mm: tuple[float, float, float, float]

    def values(self, per_element: Float[np.ndarray, " m"]) -> Float[np.ma.MaskedArray, "r c"]:
        """Return the value of each pixel; pixels outside the body are masked."""
        return np.ma.masked_where(self.elements < 0, per_element[self.elements])

    def centres_mm(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the pixel centres along the horizontal and the vertical, mm."""
        rows, columns = self.elements.shape
        left, right, bottom, top = self.extent_mm
        return _centres(left, right, columns), _centres(bottom, top, rows)

    def draw(self, axes: Axes, per_element: Float[np.ndarray, " m"], **options: Any) -> AxesImage:
        """Draw the value of each element with `imshow` and its options."""
        return axes.imshow(
            self.values(per_element), extent=self.extent_mm, origin="lower",
            interpolation="nearest", **options,
        )  # fmt: skip


def slice_body(mesh: TetMesh, n_slices: int, pixels: int) -> tuple[tuple[Slice, ...], ...]:
    """Cut a mesh by evenly spaced planes across x, y and z.

    Each plane is in the middle of one of `n_slices` equal slabs, so that none is on the surface.

    Args:
        mesh: Mesh of the body.
        n_slices: Number of planes across each axis.
        pixels: Number of pixels along the longest side of the bounding box.

    Returns:
        The slices across x, y and z, each in order of position.
    """
    low, high = mesh.bounds
    return _cut(mesh, [_centres(low[a], high[a], n_slices) for a in range(3)], pixels)


def slices_at(
    mesh: TetMesh, point_mm: Float[np.ndarray, "3"], pixels: int
) -> tuple[Slice, Slice, Slice]:
    """Cut a mesh through a point by planes across x, y and z; see `slice_body`.

    A plane on the surface is moved into the body by one pixel.
    """
    low, high = mesh.bounds
    pixel = float((high - low).max()) / pixels
    within = np.clip(point_mm, low + pixel, high - pixel)
    x, y, z = (row[0] for row in _cut(mesh, list(within[:, None]), pixels))
    return x, y, z


def _cut(
    mesh: TetMesh, positions: list[Float[np.ndarray, " k"]], pixels: int
) -> tuple[tuple[Slice, ...], ...]:
    """Cut across x, y and z, at the same number of positions each."""
    low, high = mesh.bounds
    n_slices = len(positions[0])
    counts = [int(np.ceil(part * pixels - 1e-9)) for part in (high - low) / (high - low).max()]
    centres = [_centres(low[a], high[a], counts[a]) for a in range(3)]
    grids = []
    for axis, (across, up) in enumerate(IN_PLANE):
        for position in positions[axis]:
            points = np.empty((counts[up], counts[across], 3))
            points[..., axis] = position + _NUDGE * mesh.diagonal
            points[..., across] = centres[across]
            points[..., up] = centres[up][:, None]
            grids.append(points)
    elements = locate(mesh, np.concatenate([points.reshape(-1, 3) for points in grids]))
    parts = np.split(elements, np.cumsum([points[..., 0].size for points in grids])[:-1])
    slices = []
    for index, (points, part) in enumerate(zip(grids, parts, strict=True)):
        axis = index // n_slices
        across, up = IN_PLANE[axis]
        extent = (float(low[across]), float(high[across]), float(low[up]), float(high[up]))
        position = float(points[0, 0, axis]) - _NUDGE * mesh.diagonal
        slices.append(Slice(axis, position, part.reshape(points.shape[:2]), extent))
    return tuple(tuple(slices[a * n_slices : (a + 1) * n_slices]) for a in range(3))


def _centres(low: float, high: float, count: int) -> np.ndarray:
    """Return the midpoints of `count` equal parts of an interval."""
    return low + (np.arange(count) + 0.5) * ((high - low) / count)


def colour_scale(
    maps: dict[str, np.ndarray], scale: str, limits: tuple[float, float] | None
) -> Normalize:
    """Choose the colour range of a reconstruction and, if known, its truth.

    Args:
        maps: Moduli, MPa, under the names "reconstruction" and "truth".
        scale: "linear" or "log".
        limits: Ends of the range, MPa; computed from the values if None.

    Raises:
        ConfigError: The scale is unknown, or it cannot show the limits.
    """
    if scale not in ("linear", "log"):
        raise ConfigError(f"scale '{scale}' is not known; choose linear or log.")
    low, high = limits if limits is not None else _limits(maps, scale)
    if not low < high:
        raise ConfigError(f"limits_mpa ({low}, {high}): the first must be less than the second.")
    if scale == "linear":
        return Normalize(low, high)
    if low <= 0:
        raise ConfigError(f"scale 'log' needs moduli above zero, but the lowest is {low} MPa.")
    return LogNorm(low, high)


def _limits(maps: dict[str, np.ndarray], scale: str) -> tuple[float, float]:
    """Return the range of the truth and of nearly all of the reconstruction."""
    values = maps["reconstruction"]
    high = min(float(values.max()), _OUTLIER_FACTOR * float(np.percentile(values, 99.5)))
    low = float(values.min())
    if low > 0:
        low = max(low, float(np.percentile(values, 0.5)) / _OUTLIER_FACTOR)
    if "truth" in maps:
        high = max(float(np.percentile(values, 99.5)), float(maps["truth"].max()))
        low = min(float(np.percentile(values, 0.5)), float(maps["truth"].min()))
    if scale == "linear":
        low = min(low, 0.0)
    return (low, high) if high > low else (0.5 * low, 1.5 * low or 1.0)

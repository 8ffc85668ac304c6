"""Plane slices through a mesh, sampled on square pixels."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from tactorch.mesh import TetMesh
from tactorch.mesh.locate import locate

# Axes shown along the picture's horizontal and vertical, for slices across x, y and z.
IN_PLANE = ((1, 2), (0, 2), (0, 1))
# Planes through the nodes of a regular mesh would show elements of both sides in turn; this
# share of the diagonal settles on one side.
_NUDGE = 1e-6


@dataclass(frozen=True, eq=False)
class Slice:
    """One plane slice.

    Attributes:
        axis: The axis it cuts across: 0, 1 or 2.
        position_mm: Where along that axis.
        elements: Tetrahedron under each pixel, -1 outside; row 0 lies lowest.
        extent_mm: Left, right, bottom and top of the pixels together.
    """

    axis: int
    position_mm: float
    elements: Int[np.ndarray, "rows columns"]
    extent_mm: tuple[float, float, float, float]

    def values(self, per_element: Float[np.ndarray, " m"]) -> Float[np.ma.MaskedArray, "r c"]:
        """Paint the pixels with a value per element; pixels outside are masked."""
        return np.ma.masked_where(self.elements < 0, per_element[self.elements])

    def centres_mm(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the pixel centres along the horizontal and along the vertical."""
        rows, columns = self.elements.shape
        left, right, bottom, top = self.extent_mm
        return _centres(left, right, columns), _centres(bottom, top, rows)


def slice_body(mesh: TetMesh, n_slices: int, pixels: int) -> tuple[tuple[Slice, ...], ...]:
    """Cut a mesh by evenly spaced planes across x, y and z.

    The planes lie in the middle of `n_slices` equal slabs, so none lies on the surface.

    Args:
        mesh: The body.
        n_slices: Planes across each axis.
        pixels: Pixels along the longest side of the bounding box.

    Returns:
        For x, y and z, the slices in order of position.
    """
    low, high = mesh.bounds
    return _cut(mesh, [_centres(low[a], high[a], n_slices) for a in range(3)], pixels)


def slices_at(
    mesh: TetMesh, point_mm: Float[np.ndarray, "3"], pixels: int
) -> tuple[Slice, Slice, Slice]:
    """Cut a mesh through a point by three planes, across x, y and z; see `slice_body`.

    A plane that would lie on the surface is moved into the body by a pixel.
    """
    low, high = mesh.bounds
    pixel = float((high - low).max()) / pixels
    within = np.clip(point_mm, low + pixel, high - pixel)
    x, y, z = (row[0] for row in _cut(mesh, list(within[:, None]), pixels))
    return x, y, z


def _cut(
    mesh: TetMesh, positions: list[Float[np.ndarray, " k"]], pixels: int
) -> tuple[tuple[Slice, ...], ...]:
    """Cut across x, y and z at as many positions each."""
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
    """Return the middles of `count` equal parts of an interval."""
    return low + (np.arange(count) + 0.5) * ((high - low) / count)

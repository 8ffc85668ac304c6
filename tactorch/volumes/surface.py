"""Closed smooth surface of a mask of voxels, of the same volume."""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage
from scipy.optimize import brentq

from tactorch.errors import MeshError
from tactorch.mesh.geometry import enclosed_volume
from tactorch.mesh.surfaces import TriangleSurface

_MIN_SIGMA = 0.7  # of the smoothing, in cells: staircases of voxels vanish
_TRUNCATE = 3.0  # standard deviations to which the smoothing reaches
_LEVELS = 0.02, 0.98  # of the smoothed mask, between which the surface is searched
_LEVEL_TOLERANCE = 1e-3


def smooth_surface(
    mask: Bool[np.ndarray, "x y z"],
    affine: Float[np.ndarray, "4 4"],
    detail_mm: float,
    *,
    keep_largest: bool = False,
) -> TriangleSurface:
    """Return vertices (mm) and outward triangles of a surface around the voxels of a mask.

    The mask is averaged over cells of up to `detail_mm`, smoothed by a Gaussian of that standard
    deviation, or of 0.7 cells where these are larger, and triangulated by marching cubes at the
    level that encloses the volume of the voxels. Beyond the array is outside.

    The matrix is that from voxel indices to positions, mm; details of 0 are those of voxels.
    `keep_largest` leaves out parts that the smoothing detaches, which are refused otherwise.
    """
    sizes = np.linalg.norm(affine[:3, :3], axis=0)
    factors = np.maximum(detail_mm // sizes, 1.0).astype(int)
    sigma = np.maximum(detail_mm / (factors * sizes), _MIN_SIGMA)
    cells, first = _averaged(mask, factors, np.ceil(_TRUNCATE * sigma).astype(int) + 1)
    field = ndimage.gaussian_filter(cells, sigma, mode="constant", truncate=_TRUNCATE)

    def surface(level: float) -> TriangleSurface:
        from skimage import measure  # takes a second to import

        vertices, triangles, _, _ = measure.marching_cubes(field, level, allow_degenerate=False)
        indices = first + factors * vertices.astype(np.float64) + 0.5 * (factors - 1)
        # Those of marching cubes are inward in right-handed axes.
        outward = triangles[:, ::-1] if determinant > 0.0 else triangles
        return indices @ affine[:3, :3].T + affine[:3, 3], outward.astype(np.int64)

    determinant = float(np.linalg.det(affine[:3, :3]))
    volume = float(mask.sum()) * abs(determinant)
    peak = float(field.max())

    def excess(fraction: float) -> float:
        return enclosed_volume(*surface(fraction * peak)) - volume

    low, high = _LEVELS
    if excess(low) < 0.0 or excess(high) > 0.0:
        raise MeshError(
            f"the surface of {mask.sum()} voxels is lost by smoothing over {detail_mm:.3g} mm; "
            "choose a smaller edge length."
        )
    level = peak * float(brentq(excess, low, high, xtol=_LEVEL_TOLERANCE))
    field = _one_part(field, level, keep_largest, detail_mm)
    return surface(level)


def extent(mask: Bool[np.ndarray, "x y z"]) -> list[tuple[int, int]]:
    """Return the first and the last index of the voxels of a mask along each axis."""
    places = (np.flatnonzero(mask.any(axis=tuple({0, 1, 2} - {axis}))) for axis in range(3))
    return [(int(p[0]), int(p[-1])) for p in places]


def _averaged(
    mask: Bool[np.ndarray, "x y z"], factors: Int[np.ndarray, "3"], margin: Int[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "a b c"], Int[np.ndarray, "3"]]:
    """Return means over cells of voxels with a margin of zeros, and the index of the first voxel.

    Only the part of the mask that is not zero is used.
    """
    from skimage.measure import block_reduce  # takes a second to import

    places = extent(mask)
    part = mask[tuple(slice(first, last + 1) for first, last in places)]
    before = margin * factors
    padded = np.pad(part, before[:, None])
    cells: np.ndarray = block_reduce(padded, tuple(factors), np.mean)
    return cells, np.array([first for first, _ in places]) - before


def _one_part(
    field: Float[np.ndarray, "a b c"], level: float, keep_largest: bool, detail_mm: float
) -> Float[np.ndarray, "a b c"]:
    """Refuse a level that has several parts, or leave out all but the largest."""
    parts, count = ndimage.label(field > level)
    if count <= 1:
        return field
    sizes = np.bincount(parts.ravel())[1:]
    if not keep_largest:
        raise MeshError(
            f"the smoothing over {detail_mm:.3g} mm detaches {count - 1} thin parts of the body; "
            "choose a smaller edge length, or leave them out by keep_largest=true."
        )
    others = (parts > 0) & (parts != 1 + int(np.argmax(sizes)))
    return np.where(others, np.minimum(field, 0.5 * level), field)

"""Point location: the tetrahedron that contains a point."""

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from tactorch.mesh.tetmesh import TetMesh

# Barycentric tolerance, so that points on shared faces are not lost to rounding.
_TOLERANCE = 1e-9
# Point-tetrahedron pairs tested at once; limits the memory to some hundred megabytes.
_MAX_PAIRS = 1_000_000


def locate(mesh: TetMesh, points: Float[np.ndarray, "p 3"], k: int = 8) -> Int[np.ndarray, " p"]:
    """Find the element that contains each point.

    The `k` elements of nearest centroid are tested first; the remaining points are tested against
    every element whose bounding ball contains them, so the result is exact. A point on a shared
    face gets one of its elements.

    Args:
        mesh: Body.
        points: Positions, mm.
        k: Number of nearest elements tested first; affects the time only.

    Returns:
        Index of the element, -1 for points outside the body.
    """
    elements = np.full(len(points), -1, dtype=np.int64)
    low, high = mesh.bounds
    margin = _TOLERANCE * mesh.diagonal
    near = np.flatnonzero(np.all((points >= low - margin) & (points <= high + margin), axis=1))
    if len(near) == 0:
        return elements
    corners = mesh.points[mesh.tets]
    inverses = np.linalg.inv((corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1))
    elements[near] = _search_nearest(mesh, inverses, points[near], k)
    rest = near[elements[near] < 0]
    if len(rest):
        elements[rest] = _search_all(mesh, inverses, points[rest])
    return elements


def _contains(
    mesh: TetMesh, inverses: np.ndarray, elements: np.ndarray, points: np.ndarray
) -> np.ndarray:
    """Whether the element of each pair contains the point."""
    offsets = points - mesh.points[mesh.tets[elements, 0]]
    local = np.einsum("qij,qj->qi", inverses[elements], offsets)
    return (local >= -_TOLERANCE).all(axis=1) & (local.sum(axis=1) <= 1.0 + _TOLERANCE)


def _search_nearest(mesh: TetMesh, inverses: np.ndarray, points: np.ndarray, k: int) -> np.ndarray:
    """Test the elements of nearest centroid in turn; -1 where none contains the point."""
    elements = np.full(len(points), -1, dtype=np.int64)
    count = max(1, min(k, mesh.n_tets))
    _, candidates = cKDTree(mesh.centroids).query(points, k=np.arange(1, count + 1))
    for column in candidates.T:
        rest = np.flatnonzero(elements < 0)
        hits = rest[_contains(mesh, inverses, column[rest], points[rest])]
        elements[hits] = column[hits]
    return elements


def _search_all(mesh: TetMesh, inverses: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Test each point against all elements whose ball around the centroid contains it."""
    result = np.full(len(points), -1, dtype=np.int64)
    corners = mesh.points[mesh.tets] - mesh.centroids[:, None]
    radii = np.linalg.norm(corners, axis=2).max(axis=1) * (1.0 + 1e-6)
    reached = cKDTree(points).query_ball_point(mesh.centroids, radii)
    counts = np.fromiter(map(len, reached), dtype=np.int64, count=len(reached))
    ends = np.cumsum(counts)
    start = 0
    while start < len(counts):
        offset = ends[start] - counts[start]
        stop = max(start + 1, int(np.searchsorted(ends, offset + _MAX_PAIRS, side="right")))
        elements = np.repeat(np.arange(start, stop), counts[start:stop])
        if len(elements):
            indices = np.concatenate([np.asarray(r, dtype=np.int64) for r in reached[start:stop]])
            hits = _contains(mesh, inverses, elements, points[indices])
            result[indices[hits]] = elements[hits]
        start = stop
    return result

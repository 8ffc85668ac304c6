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
    """Return the index of the element that contains each point (mm), -1 outside the body.

    The `k` elements of nearest centroid are tested first; the remaining points are tested against
    every element whose bounding ball contains them, so the result is exact. A point on a shared
    face gets one of its elements.
    """
    elements = np.full(len(points), -1, dtype=np.int64)
    low, high = mesh.bounds
    margin = _TOLERANCE * mesh.diagonal
    near = np.flatnonzero(np.all((points >= low - margin) & (points <= high + margin), axis=1))
    if not len(near):
        return elements
    corners = mesh.points[mesh.tets]
    inverses = np.linalg.inv((corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1))

    def assign(candidates: np.ndarray, indices: np.ndarray) -> None:
        """Assign each candidate element to the point of the same row, if it contains it."""
        offsets = points[indices] - corners[candidates, 0]
        local = np.einsum("qij,qj->qi", inverses[candidates], offsets)
        inside = (local >= -_TOLERANCE).all(axis=1) & (local.sum(axis=1) <= 1.0 + _TOLERANCE)
        elements[indices[inside]] = candidates[inside]

    count = max(1, min(k, mesh.n_tets))
    _, nearest = cKDTree(mesh.centroids).query(points[near], k=np.arange(1, count + 1))
    for column in nearest.T:
        missing = elements[near] < 0
        assign(column[missing], near[missing])
    rest = near[elements[near] < 0]
    if not len(rest):
        return elements
    radii = np.linalg.norm(corners - mesh.centroids[:, None], axis=2).max(axis=1) * (1.0 + 1e-6)
    reached = cKDTree(points[rest]).query_ball_point(mesh.centroids, radii)
    counts = np.fromiter(map(len, reached), dtype=np.int64, count=len(reached))
    ends = np.flatnonzero(np.diff(np.cumsum(counts) // _MAX_PAIRS)) + 1
    for block in np.split(np.arange(mesh.n_tets), ends):
        indices = np.concatenate([np.asarray(r, dtype=np.int64) for r in reached[block]])
        assign(np.repeat(block, counts[block]), rest[indices])
    return elements

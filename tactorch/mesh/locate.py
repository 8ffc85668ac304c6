"""Which tetrahedron holds a point."""

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from tactorch.mesh.tetmesh import TetMesh

# Barycentric slack, so that points on shared faces are not lost to rounding.
_SLACK = 1e-9
# Point-tetrahedron pairs tested at once; bounds the memory to some hundred megabytes.
_PAIRS = 1_000_000


def locate(mesh: TetMesh, points: Float[np.ndarray, "p 3"], k: int = 8) -> Int[np.ndarray, " p"]:
    """Find the element that holds each point.

    The `k` elements of nearest centroid are tried first, which settles most points; those left
    are tested against every element whose bounding ball reaches them, so the answer is exact.
    A point on a shared face gets one of its elements.

    Args:
        mesh: The body.
        points: Positions, mm.
        k: Nearest elements tried first; affects the time, never the answer.

    Returns:
        Index of the element, -1 for points outside the body.
    """
    found = np.full(len(points), -1, dtype=np.int64)
    low, high = mesh.bounds
    slack = _SLACK * mesh.diagonal
    near = np.flatnonzero(np.all((points >= low - slack) & (points <= high + slack), axis=1))
    if len(near) == 0:
        return found
    inverses = np.linalg.inv(_edges(mesh))
    found[near] = _among_nearest(mesh, inverses, points[near], k)
    left = near[found[near] < 0]
    if len(left):
        found[left] = _among_reaching(mesh, inverses, points[left])
    return found


def _edges(mesh: TetMesh) -> np.ndarray:
    """Return (m, 3, 3): per element, the edges from its first vertex as columns."""
    corners = mesh.points[mesh.tets]
    return (corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1)


def _inside(
    mesh: TetMesh, inverses: np.ndarray, elements: np.ndarray, points: np.ndarray
) -> np.ndarray:
    """Tell for each pair of element and point whether the element holds the point."""
    offsets = points - mesh.points[mesh.tets[elements, 0]]
    local = np.einsum("qij,qj->qi", inverses[elements], offsets)
    return (local >= -_SLACK).all(axis=1) & (local.sum(axis=1) <= 1.0 + _SLACK)


def _among_nearest(mesh: TetMesh, inverses: np.ndarray, points: np.ndarray, k: int) -> np.ndarray:
    """Try the elements of nearest centroid in turn; -1 where none holds the point."""
    found = np.full(len(points), -1, dtype=np.int64)
    count = max(1, min(k, mesh.n_tets))
    _, candidates = cKDTree(mesh.centroids).query(points, k=np.arange(1, count + 1))
    for column in candidates.T:
        open_ = np.flatnonzero(found < 0)
        hit = open_[_inside(mesh, inverses, column[open_], points[open_])]
        found[hit] = column[hit]
    return found


def _among_reaching(mesh: TetMesh, inverses: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Test each point against all elements whose ball around the centroid holds it."""
    found = np.full(len(points), -1, dtype=np.int64)
    corners = mesh.points[mesh.tets] - mesh.centroids[:, None]
    radii = np.linalg.norm(corners, axis=2).max(axis=1) * (1.0 + 1e-6)
    reached = cKDTree(points).query_ball_point(mesh.centroids, radii)
    counts = np.fromiter(map(len, reached), dtype=np.int64, count=len(reached))
    ends = np.cumsum(counts)
    start = 0
    while start < len(counts):
        offset = ends[start] - counts[start]
        stop = max(start + 1, int(np.searchsorted(ends, offset + _PAIRS, side="right")))
        elements = np.repeat(np.arange(start, stop), counts[start:stop])
        if len(elements):
            which = np.concatenate([np.asarray(r, dtype=np.int64) for r in reached[start:stop]])
            hit = _inside(mesh, inverses, elements, points[which])
            found[which[hit]] = elements[hit]
        start = stop
    return found

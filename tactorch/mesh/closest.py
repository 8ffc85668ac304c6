"""Points of a triangle surface that are closest to given points."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from tactorch.mesh.values import Points, Triangles

_CHUNK = 4096  # pairs of points and triangles whose closest points are found at once


class Closest(NamedTuple):
    """Closest points of a surface."""

    triangles: Int[np.ndarray, " q"]  # on which the points are
    barycentric: Float[np.ndarray, "q 3"]  # coordinates on these
    points: Float[np.ndarray, "q 3"]  # mm
    distances: Float[np.ndarray, " q"]  # from the given points, mm


def closest_points(
    points: Points, triangles: Triangles, queries: Float[np.ndarray, "q 3"]
) -> Closest:
    """Return the points (mm) of a surface that are closest to the queries.

    A triangle can be the closest only if its centroid is within the distance of the nearest vertex
    plus the largest distance of a centroid from its vertices.
    """
    corners = points[triangles]
    centroids = corners.mean(axis=1)
    reaches = np.linalg.norm(corners - centroids[:, None], axis=2).max(axis=1)
    nearest, _ = cKDTree(points[np.unique(triangles)]).query(queries)
    # Triangles of similar size together: large ones do not make many small ones candidates.
    sizes = np.floor(np.log2(np.maximum(reaches, 1e-300)))
    found = [
        _within(centroids, np.flatnonzero(sizes == size), reaches, queries, nearest)
        for size in np.unique(sizes)
    ]
    rows, pairs = (np.concatenate(parts) for parts in zip(*found, strict=True))
    coordinates = np.concatenate([
        _closest(corners[pairs[i : i + _CHUNK]], queries[rows[i : i + _CHUNK]])
        for i in range(0, max(len(pairs), 1), _CHUNK)
    ])  # fmt: skip
    at = np.einsum("pk,pkd->pd", coordinates, corners[pairs])
    distances = np.linalg.norm(at - queries[rows], axis=1)
    order = np.lexsort((pairs, distances, rows))
    first = order[np.searchsorted(rows[order], np.arange(len(queries)))]
    return Closest(pairs[first], coordinates[first], at[first], distances[first])


def _within(
    centroids: Float[np.ndarray, "t 3"],
    chosen: Int[np.ndarray, " s"],
    reaches: Float[np.ndarray, " t"],
    queries: Float[np.ndarray, "q 3"],
    nearest: Float[np.ndarray, " q"],
) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"]]:
    """Return pairs of a query and one of the chosen triangles that may be the closest to it."""
    limits = (nearest + reaches[chosen].max()) * (1.0 + 1e-9) + 1e-12
    lists = cKDTree(centroids[chosen]).query_ball_point(queries, limits)
    counts = [len(found) for found in lists]
    pairs = np.concatenate([*(np.array(found, dtype=np.int64) for found in lists), []]).astype(int)
    return np.repeat(np.arange(len(queries)), counts), chosen[pairs]


def _closest(
    corners: Float[np.ndarray, "p 3 3"], queries: Float[np.ndarray, "p 3"]
) -> Float[np.ndarray, "p 3"]:
    """Barycentric coordinates of the closest point of each triangle.

    It is the projection if that is inside, and otherwise the closest point of an edge.
    """
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    u, v, w = b - a, c - a, queries - a
    uu, uv, vv = (u * u).sum(1), (u * v).sum(1), (v * v).sum(1)
    uw, vw = (u * w).sum(1), (v * w).sum(1)
    determinant = uu * vv - uv**2
    beta, gamma = (vv * uw - uv * vw) / determinant, (uu * vw - uv * uw) / determinant
    best = np.column_stack([1.0 - beta - gamma, beta, gamma])
    outside = (best < 0.0).any(axis=1)
    distance = np.where(outside, np.inf, 0.0)
    for k in range(3):
        start, end = corners[:, k], corners[:, (k + 1) % 3]
        side = end - start
        fraction = np.clip(((queries - start) * side).sum(1) / (side * side).sum(1), 0.0, 1.0)
        apart = np.linalg.norm(start + fraction[:, None] * side - queries, axis=1)
        nearer = apart < distance
        edge = np.zeros_like(best)
        edge[:, k], edge[:, (k + 1) % 3] = 1.0 - fraction, fraction
        best[nearer], distance[nearer] = edge[nearer], apart[nearer]
    return best

"""Volumes, areas, bounding boxes and distances of arrays of points and cells."""

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from tactorch.mesh.values import Corners, Points, Tets, Triangles

_MIN_VOLUME = 0.2  # of an element after its nodes are moved, over that before


def signed_volumes(points: Points, tets: Tets) -> Float[np.ndarray, " m"]:
    """Return signed volumes, positive where vertex 3 sees 0, 1, 2 turn counter-clockwise."""
    a, b, c = (points[tets[:, i]] - points[tets[:, 0]] for i in (1, 2, 3))
    return np.einsum("mi,mi->m", np.cross(a, b), c) / 6.0


def area_vectors(points: Points, triangles: Triangles) -> Float[np.ndarray, "k 3"]:
    """Return each triangle's area times its unit normal."""
    a, b, c = (points[triangles[:, i]] for i in range(3))
    return np.cross(b - a, c - a) / 2.0


def unit_rows(vectors: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "k 3"]:
    """Return vectors scaled to length 1; zeros remain."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300)


def vertex_areas(points: Points, triangles: Triangles) -> Float[np.ndarray, " n"]:
    """Return one third of the area of the triangles at each node."""
    areas = np.linalg.norm(area_vectors(points, triangles), axis=1)
    return np.bincount(triangles.ravel(), np.repeat(areas / 3.0, 3), len(points))


def surface_area(points: Points, faces: Triangles) -> float:
    """Return the total area of triangles."""
    return float(np.linalg.norm(area_vectors(points, faces), axis=1).sum())


def enclosed_volume(points: Points, faces: Triangles) -> float:
    """Return the volume inside a closed outward surface (divergence theorem)."""
    centroids = points[faces].mean(axis=1) - points[faces[0, 0]]
    return float((centroids * area_vectors(points, faces)).sum() / 3.0)


def bounding_box(points: Points) -> Corners:
    """Return the lowest and the highest corner."""
    return np.stack((points.min(axis=0), points.max(axis=0)))


def bounding_diagonal(points: Points) -> float:
    """Return the length of the bounding box's diagonal."""
    low, high = bounding_box(points)
    return float(np.linalg.norm(high - low))


def without_flat_elements(before: Points, after: Points, tets: Tets) -> Points:
    """Return moved nodes, with those of elements that lost most of their volume where they were."""
    limits, moved = _MIN_VOLUME * signed_volumes(before, tets), after.copy()
    while (flat := signed_volumes(moved, tets) < limits).any():
        nodes = np.unique(tets[flat])
        moved[nodes] = before[nodes]
    return moved


def frozen(array: NDArray) -> NDArray:
    """Return `array`, made read-only."""
    array.setflags(write=False)
    return array


def farthest_point_order(points: Float[np.ndarray, "n d"], count: int, first: int) -> list[int]:
    """Order points by farthest-point sampling: each is farthest from those before it.

    At most `count` distinct indices are returned, `first` before the others.
    """
    order = [first]
    distances = np.linalg.norm(points - points[first], axis=1)
    distances[first] = -1.0
    while len(order) < min(count, len(points)):
        order.append(int(distances.argmax()))
        distances = np.minimum(distances, np.linalg.norm(points - points[order[-1]], axis=1))
        distances[order[-1]] = -1.0
    return order

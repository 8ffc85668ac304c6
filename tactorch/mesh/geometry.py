"""Volumes, areas, bounding boxes and distances of arrays of points and cells."""

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray


def signed_volumes(
    points: Float[np.ndarray, "n 3"], tets: Int[np.ndarray, "m 4"]
) -> Float[np.ndarray, " m"]:
    """Return signed volumes, positive where vertex 3 sees 0, 1, 2 turn counter-clockwise."""
    a, b, c = (points[tets[:, i]] - points[tets[:, 0]] for i in (1, 2, 3))
    return np.einsum("mi,mi->m", np.cross(a, b), c) / 6.0


def longest_edges(
    points: Float[np.ndarray, "n 3"], tets: Int[np.ndarray, "m 4"]
) -> Float[np.ndarray, " m"]:
    """Return the length of each element's longest edge."""
    corners = points[tets]
    squares = [
        np.square(corners[:, i] - corners[:, j]).sum(axis=1) for i in range(4) for j in range(i)
    ]
    return np.sqrt(np.max(squares, axis=0))


def area_vectors(
    points: Float[np.ndarray, "n 3"], triangles: Int[np.ndarray, "k 3"]
) -> Float[np.ndarray, "k 3"]:
    """Return each triangle's area times its unit normal."""
    a, b, c = (points[triangles[:, i]] for i in range(3))
    return np.cross(b - a, c - a) / 2.0


def surface_area(points: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "k 3"]) -> float:
    """Return the total area of triangles."""
    return float(np.linalg.norm(area_vectors(points, faces), axis=1).sum())


def enclosed_volume(points: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "k 3"]) -> float:
    """Return the volume inside a closed outward surface (divergence theorem)."""
    centroids = points[faces].mean(axis=1) - points[faces[0, 0]]
    return float((centroids * area_vectors(points, faces)).sum() / 3.0)


def bounding_box(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "2 3"]:
    """Return the lowest and the highest corner."""
    return np.stack((points.min(axis=0), points.max(axis=0)))


def bounding_diagonal(points: Float[np.ndarray, "n 3"]) -> float:
    """Return the length of the bounding box's diagonal."""
    low, high = bounding_box(points)
    return float(np.linalg.norm(high - low))


def frozen(array: NDArray) -> NDArray:
    """Return `array`, made read-only."""
    array.setflags(write=False)
    return array


def farthest_point_order(points: Float[np.ndarray, "n d"], count: int, first: int) -> list[int]:
    """Order points by farthest-point sampling: each is farthest from those before it.

    Args:
        points: Positions.
        count: Number of points to select; all are selected if there are fewer.
        first: Index of the first point.

    Returns:
        Distinct indices, even where points coincide.
    """
    order = [first]
    distances = np.linalg.norm(points - points[first], axis=1)
    distances[first] = -1.0
    while len(order) < min(count, len(points)):
        order.append(int(distances.argmax()))
        distances = np.minimum(distances, np.linalg.norm(points - points[order[-1]], axis=1))
        distances[order[-1]] = -1.0
    return order

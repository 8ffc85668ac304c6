"""Volumes, areas and normals, vectorised."""

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray


def signed_volumes(
    points: Float[np.ndarray, "n 3"], tets: Int[np.ndarray, "m 4"]
) -> Float[np.ndarray, " m"]:
    """Return the signed volumes, positive where vertex 3 sees 0, 1, 2 turn counter-clockwise."""
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


def bounding_box(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "2 3"]:
    """Return the lowest and the highest corner."""
    return np.stack((points.min(axis=0), points.max(axis=0)))


def frozen(array: NDArray) -> NDArray:
    """Return `array`, made read-only."""
    array.setflags(write=False)
    return array

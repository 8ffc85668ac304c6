"""What must hold of a triangle surface before it can be filled with tetrahedra."""

import numpy as np
from jaxtyping import Float, Int

from tactorch.errors import MeshError
from tactorch.mesh.checks import as_cells, as_points, listing
from tactorch.mesh.geometry import area_vectors, bounding_box
from tactorch.mesh.values import Rows


def closed_surface(
    vertices: Rows, triangles: Rows
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "k 3"]]:
    """Return the surface as float64 and int64, turned outward, or raise `MeshError`.

    Each edge must belong to exactly two triangles that run along it in opposite senses, and the
    surface must enclose a volume. Unreferenced vertices are harmless.
    """
    points = as_points(vertices, "vertices")
    faces = as_cells(triangles, 3, len(points), "triangles")
    _check_edges(faces, len(points))
    volume = enclosed_volume(points, faces)
    corners = bounding_box(points[faces.ravel()])
    if abs(volume) <= 1e-9 * np.linalg.norm(corners[1] - corners[0]) ** 3:
        raise MeshError("The surface encloses no volume: it is flat or folded onto itself.")
    return points, faces if volume > 0 else faces[:, ::-1].copy()


def enclosed_volume(points: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "k 3"]) -> float:
    """Return the volume inside a closed outward surface (divergence theorem)."""
    middles = points[faces].mean(axis=1) - points[faces[0, 0]]
    return float((middles * area_vectors(points, faces)).sum() / 3.0)


def surface_area(points: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "k 3"]) -> float:
    """Return the total area."""
    return float(np.linalg.norm(area_vectors(points, faces), axis=1).sum())


def _check_edges(faces: Int[np.ndarray, "k 3"], n_points: int) -> None:
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    keys = np.minimum(start, end) * n_points + np.maximum(start, end)
    unique, inverse, counts = np.unique(keys, return_inverse=True, return_counts=True)
    owners = np.arange(len(keys)) // 3
    if (counts == 1).any():
        bad = np.unique(owners[counts[inverse] == 1])
        raise MeshError(
            f"The surface is open: {(counts == 1).sum()} of its {len(unique)} edges belong to one"
            f" triangle only, at {listing(bad, len(faces), 'triangles')}. Close the holes; if each"
            " triangle has vertices of its own, merge equal ones (read_surface does)."
        )
    if (counts > 2).any():
        bad = np.unique(owners[counts[inverse] > 2])
        raise MeshError(
            f"The surface is not a manifold: {(counts > 2).sum()} of its {len(unique)} edges belong"
            f" to more than two triangles, at {listing(bad, len(faces), 'triangles')}."
            " Remove duplicate or inner triangles."
        )
    sense = np.bincount(inverse, weights=np.sign(end - start))
    if sense.any():
        bad = np.unique(owners[sense[inverse] != 0])
        raise MeshError(
            "The surface's triangles are not turned the same way around at"
            f" {listing(bad, len(faces), 'triangles')}: make their normals consistent."
        )

"""Sharp edges of the surface of a mesh. Lengths in mm."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from tactorch.mesh.tetmesh import TetMesh
from tactorch.mesh.topology import matched_edges, triangle_edges
from tactorch.mesh.values import Triangles

_SHARP = 0.7  # cosine of the angle between the normals at a sharp edge
_POINTS = 9  # on an edge, from which distances are measured


def sharp_edges(
    triangles: Triangles, normals: Float[np.ndarray, "k 3"], cosine: float
) -> Int[np.ndarray, "e 2"]:
    """Return the edges of a closed surface where the cosine between unit normals is lower."""
    edges = triangle_edges(triangles)
    first, second = matched_edges(edges).T
    return edges[first[(normals[first // 3] * normals[second // 3]).sum(axis=1) < cosine]]


def distance_from_sharp_edges(
    mesh: TetMesh,
) -> Callable[[Float[np.ndarray, "k 3"]], Float[np.ndarray, " k"]]:
    """Return the distance (mm) of points (mm) from the edges where the surface of a mesh is sharp.

    It is infinite where there are none.
    """
    ends = mesh.points[sharp_edges(mesh.surface.triangles, mesh.surface.normals, _SHARP)]
    parts = np.linspace(0.0, 1.0, _POINTS)[:, None, None]
    tree = cKDTree(((1.0 - parts) * ends[:, 0] + parts * ends[:, 1]).reshape(-1, 3))
    return lambda points: np.asarray(tree.query(points)[0])

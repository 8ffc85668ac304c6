"""Nodal forces of tractions and pressures that are given at the nodes of triangles.

They are linear on each triangle. At the rim of a contact within a smooth face they decline to zero
across the triangles that the rim passes, so that the total is that of the sampled field. Across a
sharp edge of the body, as between the pressed top and the sides of a block, they end at the edge.
"""

import numpy as np
from jaxtyping import Bool, Float, Int

from tactorch.mesh.geometry import area_vectors

_MIN_COSINE = 0.8  # between normals where a surface continues across an edge


def consistent_loads(
    points: Float[np.ndarray, "n 3"],
    triangles: Int[np.ndarray, "k 3"],
    tractions: Float[np.ndarray, "n 3"],
    same: Int[np.ndarray, " n"] | None = None,
) -> Float[np.ndarray, "n 3"]:
    """Return nodal forces (N) of tractions (MPa) that are linear on each triangle.

    Args:
        points: Nodes, mm.
        triangles: Triangles of the surface, with consistent orientation.
        tractions: Traction at the nodes, zero where there is none.
        same: The first of the nodes at the position of each, where surfaces repeat nodes at edges.
    """
    vectors = area_vectors(points, triangles)
    loaded = loaded_triangles(vectors, triangles, (tractions != 0.0).any(axis=1), same)
    areas = np.linalg.norm(vectors[loaded], axis=1)
    corners = tractions[triangles[loaded]]
    loads = areas[:, None, None] / 12.0 * (corners + corners.sum(axis=1, keepdims=True))
    forces = np.zeros_like(points)
    np.add.at(forces, triangles[loaded], loads)
    return forces


def pressure_loads(
    points: Float[np.ndarray, "n 3"],
    triangles: Int[np.ndarray, "k 3"],
    pressure: Float[np.ndarray, " n"],
    same: Int[np.ndarray, " n"] | None = None,
) -> Float[np.ndarray, "n 3"]:
    """Return nodal forces (N) of a pressure (MPa) that is linear on each outward triangle.

    It acts along the inward normal of the triangle.

    Args:
        points: Nodes, mm.
        triangles: Triangles of the surface, with outward normals.
        pressure: Pressure at the nodes, zero where there is none.
        same: The first of the nodes at the position of each, where surfaces repeat nodes at edges.
    """
    vectors = area_vectors(points, triangles)
    loaded = loaded_triangles(vectors, triangles, pressure != 0.0, same)
    corners = pressure[triangles[loaded]]
    shares = (corners + corners.sum(axis=1, keepdims=True)) / 12.0
    forces = np.zeros_like(points)
    np.add.at(forces, triangles[loaded], -shares[:, :, None] * vectors[loaded][:, None])
    return forces


def loaded_triangles(
    vectors: Float[np.ndarray, "k 3"],
    triangles: Int[np.ndarray, "k 3"],
    acts: Bool[np.ndarray, " n"],
    same: Int[np.ndarray, " n"] | None = None,
) -> Bool[np.ndarray, " k"]:
    """Return the triangles on which nodal tractions act.

    These are the triangles that have a traction at all nodes, and those with some such nodes that
    continue the surface there: their normal is within 37 degrees of the mean normal of the former
    triangles at each of these nodes, or of all triangles where there is none.

    Args:
        vectors: Normals of the triangles times their areas, mm^2.
        triangles: Their nodes.
        acts: Whether there is a traction at a node.
        same: The first of the nodes at the position of each; None where no node is repeated.
    """
    at_corner = np.asarray(acts[triangles])
    full, some = np.all(at_corner, axis=1), np.any(at_corner, axis=1)
    corners = triangles if same is None else same[triangles]
    around = _sums(vectors, corners, len(acts))
    beside = _sums(vectors[full], corners[full], len(acts))
    is_loaded = np.asarray(np.any(beside, axis=1))
    normals = np.where(is_loaded[:, None], beside, around)[corners]
    sizes = np.linalg.norm(normals, axis=2) * np.linalg.norm(vectors, axis=1)[:, None]
    continues = (normals * vectors[:, None]).sum(axis=2) >= _MIN_COSINE * sizes
    return np.asarray(full | (some & np.all(continues | ~at_corner, axis=1)))


def _sums(
    vectors: Float[np.ndarray, "k 3"], corners: Int[np.ndarray, "k 3"], count: int
) -> Float[np.ndarray, "n 3"]:
    """Return the sum of the vectors of the triangles at each node."""
    sums = np.zeros((count, 3))
    for nodes in corners.T:
        np.add.at(sums, nodes, vectors)
    return sums

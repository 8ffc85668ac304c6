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
    loads: Float[np.ndarray, "n ..."],
    same: Int[np.ndarray, " n"] | None = None,
) -> Float[np.ndarray, "n 3"]:
    """Return nodal forces (N) of tractions or of a pressure (MPa), linear on each triangle.

    Args:
        points: Nodes, mm.
        triangles: Triangles of the surface, with consistent orientation; outward for a pressure.
        loads: Traction at the nodes, (n, 3), or pressure along the inward normal of the triangles,
            (n,); zero where there is none.
        same: The first of the nodes at the position of each, where surfaces repeat nodes at edges.
    """
    vectors = area_vectors(points, triangles)
    corners = triangles if same is None else same[triangles]
    values = loads.reshape(len(points), -1)
    loaded = _loaded_triangles(
        vectors, np.asarray(values.any(axis=1))[triangles], corners, len(points)
    )
    vectors, triangles = vectors[loaded], triangles[loaded]
    weights = -vectors if loads.ndim == 1 else np.linalg.norm(vectors, axis=1, keepdims=True)
    shares = (values[triangles] + values[triangles].sum(axis=1, keepdims=True)) / 12.0
    return _sums(shares * weights[:, None], triangles, len(points))


def push_direction(forces: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "3"] | None:
    """Return the unit vector of the total force; None of a press from two sides, by round-off."""
    total = forces.sum(axis=0)
    length = float(np.linalg.norm(total))
    return total / length if length > 1e-9 * np.abs(forces).sum() else None


def _loaded_triangles(
    vectors: Float[np.ndarray, "k 3"],
    acts: Bool[np.ndarray, "k 3"],
    corners: Int[np.ndarray, "k 3"],
    count: int,
) -> Bool[np.ndarray, " k"]:
    """Return the triangles on which tractions act that are not zero at some of their corners.

    These are the triangles that have a traction at all nodes, and those with some such nodes that
    continue the surface there: their normal is within 37 degrees of the mean normal of the former
    triangles at each of these nodes, or of all triangles where there is none.
    """
    full = acts.all(axis=1)
    around = _sums(vectors[:, None], corners, count)
    beside = _sums(vectors[full][:, None], corners[full], count)
    normals = np.where(beside.any(axis=1, keepdims=True), beside, around)[corners]
    sizes = np.linalg.norm(normals, axis=2) * np.linalg.norm(vectors, axis=1)[:, None]
    continues = (normals * vectors[:, None]).sum(axis=2) >= _MIN_COSINE * sizes
    return np.asarray(full | (acts.any(axis=1) & (continues | ~acts).all(axis=1)))


def _sums(
    values: Float[np.ndarray, "k _ 3"], corners: Int[np.ndarray, "k 3"], count: int
) -> Float[np.ndarray, "n 3"]:
    """Return the sums at nodes of values at the corners of triangles."""
    sums = np.zeros((count, 3))
    np.add.at(sums, corners, values)
    return sums

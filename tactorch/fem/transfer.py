"""Interpolation of displacements between meshes."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from tactorch.errors import MeshError
from tactorch.fem.elements import Discretisation
from tactorch.mesh import TetMesh, locate
from tactorch.mesh.topology import LOCAL_EDGES

# Number of elements of nearest centroid tested for a point outside the mesh.
_N_CANDIDATES = 64
# Maximum distance of a point outside the mesh, as a fraction of the diagonal: meshes of one curved
# body differ.
_MAX_OUTSIDE = 1e-2


@dataclass(frozen=True, eq=False)
class Transfer:
    """Interpolation with the shape functions of linear or quadratic elements."""

    nodes: Int[np.ndarray, "p k"]  # from which each target point is interpolated
    weights: Float[np.ndarray, "p k"]  # of these nodes; their sum is 1

    @classmethod
    def between(cls, source: Discretisation, points: Float[np.ndarray, "p 3"]) -> "Transfer":
        """Prepare the interpolation from `source` to points (mm).

        The field of the nearest element is extrapolated to points outside by up to 1 % of the
        diagonal, as occur between two meshes of one curved surface.
        """
        mesh = source.mesh
        elements = locate(mesh, points)
        outside = np.flatnonzero(elements < 0)
        if outside.size:
            elements[outside] = _nearest_elements(mesh, points[outside])
        weights = L = _barycentric(mesh, elements, points)
        if source.element.quadratic:
            a, b = LOCAL_EDGES.T
            weights = np.concatenate((L * (2.0 * L - 1.0), 4.0 * L[:, a] * L[:, b]), axis=1)
        return cls(source.nodes[elements], weights)

    def __call__(self, values: Float[np.ndarray, "nodes 3"]) -> Float[np.ndarray, "p 3"]:
        """Return the field of nodal values (midsides included) at the target points."""
        return np.einsum("pk,pkd->pd", self.weights, values[self.nodes])


def _barycentric(
    mesh: TetMesh, elements: Int[np.ndarray, " p"], points: Float[np.ndarray, "p 3"]
) -> Float[np.ndarray, "p 4"]:
    corners = mesh.points[mesh.tets[elements]]
    edges = (corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1)
    others = np.linalg.solve(edges, (points - corners[:, 0])[:, :, None])[:, :, 0]
    return np.column_stack((1.0 - others.sum(axis=1), others))


def _nearest_elements(mesh: TetMesh, points: Float[np.ndarray, "p 3"]) -> Int[np.ndarray, " p"]:
    """Return the element nearest to each point outside the mesh."""
    count = min(_N_CANDIDATES, mesh.n_tets)
    _, near = cKDTree(mesh.centroids).query(points, k=np.arange(1, count + 1))
    repeated = np.repeat(points, count, axis=0)
    L = _barycentric(mesh, near.ravel(), repeated).clip(0.0)
    L /= L.sum(axis=1, keepdims=True)
    inside = np.einsum("pc,pcd->pd", L, mesh.points[mesh.tets[near.ravel()]])
    distances = np.linalg.norm(inside - repeated, axis=1).reshape(near.shape)
    outside = float(distances.min(axis=1).max())
    if outside > _MAX_OUTSIDE * mesh.diagonal:
        raise MeshError(
            f"A node of the mesh is about {outside:.3g} mm outside the fine mesh: the two are not"
            " of the same body. Mesh the same phantom twice."
        )
    return near[np.arange(len(near)), distances.argmin(axis=1)]

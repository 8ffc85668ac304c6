"""Surface tractions that nodal forces stand for.

Nodal forces f of linear elements are the integrals of a traction times the hat functions of the
surface nodes. The traction t that is linear on each loaded triangle follows from them by the mass
matrix, M t = f; its total force and moment are those of f. A triangle is loaded if all its vertices
have non-zero forces. Nodes without a loaded triangle carry point forces.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg
from jaxtyping import Bool, Float, Int

from tactorch.mesh.topology import Surface


@dataclass(frozen=True, eq=False)
class LoadedSurface:
    """The part of a surface on which forces act."""

    triangles: Int[np.ndarray, "k 3"]  # loaded ones
    areas: Float[np.ndarray, " k"]  # mm^2
    n_points: int  # of the mesh

    @staticmethod
    def of(surface: Surface, values: Float[np.ndarray, "n 3"]) -> "LoadedSurface":
        """Return the triangles whose vertices all have non-zero `values`."""
        loaded = loaded_triangles(surface, values)
        return LoadedSurface(surface.triangles[loaded], surface.areas[loaded], len(values))

    @cached_property
    def nodes(self) -> Int[np.ndarray, " loaded"]:
        """Nodes of the loaded triangles, ascending."""
        return np.unique(self.triangles)

    @cached_property
    def areas_around(self) -> Float[np.ndarray, " n"]:
        """Area of the loaded triangles at each node, mm^2."""
        around = np.bincount(self.triangles.ravel(), np.repeat(self.areas, 3), self.n_points)
        return around.astype(np.float64)  # integers where nothing is loaded

    @cached_property
    def mass(self) -> sp.csr_matrix:
        """Integrals of the products of hat functions over the loaded triangles, mm^2."""
        return self.assemble(self.areas[:, None, None] * (np.ones((3, 3)) + np.eye(3)) / 12.0)

    def assemble(self, blocks: Float[np.ndarray, "k 3 3"]) -> sp.csr_matrix:
        """Return the matrix of all nodes from that of the vertices of each triangle."""
        rows, cols = np.repeat(self.triangles, 3, axis=1), np.tile(self.triangles, 3)
        entries = (blocks.ravel(), (rows.ravel(), cols.ravel()))
        return sp.csr_matrix(entries, shape=(self.n_points, self.n_points))

    @cached_property
    def _factors(self) -> Any:
        inner = self.mass[self.nodes][:, self.nodes].tocsc()
        return scipy.sparse.linalg.splu(inner, permc_spec="MMD_AT_PLUS_A")

    def tractions(self, forces: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Return the traction at the loaded nodes (N/mm^2), zero elsewhere."""
        out = np.zeros_like(forces)
        if len(self.nodes):
            out[self.nodes] = self._factors.solve(np.ascontiguousarray(forces[self.nodes]))
        return out


def loaded_triangles(
    surface: Surface, values: Float[np.ndarray, "n 3"]
) -> Bool[np.ndarray, " triangles"]:
    """Return which triangles have non-zero `values` at all vertices."""
    return np.asarray((values != 0).any(axis=1)[surface.triangles].all(axis=1))

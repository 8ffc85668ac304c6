"""The outer face of a meshed gel as a loaded surface."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int

from tactorch.fem import SoftBody
from tactorch.sensor.gel.mesh import GelMesh


@dataclass(frozen=True, eq=False)
class GelFace:
    """Forces on the face's nodes, and what they are to the elements.

    Attributes:
        meshed: The gel.
        body: The gel as a soft body on that mesh.
    """

    meshed: GelMesh
    body: SoftBody

    @cached_property
    def _on(self) -> Bool[np.ndarray, " n"]:
        on = np.zeros(self.meshed.mesh.n_points, dtype=bool)
        on[self.meshed.face] = True
        return on

    @cached_property
    def triangles(self) -> Int[np.ndarray, "t 3"]:
        """Triangles of the face, as places among its nodes."""
        place = np.full(self.meshed.mesh.n_points, -1)
        place[self.meshed.face] = np.arange(len(self.meshed.face))
        triangles = self.meshed.mesh.surface.triangles
        return place[triangles[self._on[triangles].all(axis=1)]]

    @cached_property
    def areas(self) -> Float[np.ndarray, " k"]:
        """A third of the triangles about each node, mm^2."""
        surface = self.meshed.mesh.surface
        areas = surface.areas[self._on[surface.triangles].all(axis=1)]
        return np.bincount(
            self.triangles.ravel(), np.repeat(areas / 3.0, 3), minlength=len(self.meshed.face)
        )

    @cached_property
    def load_matrix(self) -> sp.csc_matrix:
        """Forces on all element nodes from those on the face's nodes, (nodes, k).

        The same whichever nodes are loaded: on quadratic elements each force is that of a traction
        about its node, not of a point, under which the node alone would give way.
        """
        everywhere = np.zeros(self.meshed.mesh.points.shape)
        everywhere[self.meshed.face] = 1.0
        matrix = self.body.discretisation.consistent_load_matrix(everywhere)
        return matrix.tocsc()[:, self.meshed.face]

    def edges(self, may: Bool[np.ndarray, " k"]) -> Int[np.ndarray, "e 2"]:
        """Pairs of neighbours among the chosen nodes, as places among these."""
        own = np.full(len(may), -1)
        own[may] = np.arange(int(may.sum()))
        pairs = own[self.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)]
        return np.unique(np.sort(pairs[(pairs >= 0).all(axis=1)], axis=1), axis=0)

    def unit_loads(self, may: Bool[np.ndarray, " k"]) -> Float[np.ndarray, "size f"]:
        """Loads on all unknowns under a unit force on each chosen node and axis."""
        shares = self.load_matrix[:, may].toarray()
        out = np.zeros((len(shares), 3, shares.shape[1], 3))
        for axis in range(3):
            out[:, axis, :, axis] = shares
        return np.asfortranarray(out.reshape(3 * len(shares), -1))

    def at_nodes(self, inner: Float[np.ndarray, "nodes 3"]) -> Float[np.ndarray, "k 3"]:
        """Gather forces on all element nodes; those of midsides go to their ends in equal parts."""
        n = self.meshed.mesh.n_points
        at = inner[:n].copy()
        if len(inner) > n:
            edges = self.body.discretisation.edges
            both = self._on[edges].all(axis=1)
            for end in (0, 1):
                np.add.at(at, edges[both, end], 0.5 * inner[n:][both])
        return at[self.meshed.face]

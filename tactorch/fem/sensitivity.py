"""How observed displacements answer to Young's moduli (eq. 10 to 14), at an equilibrium.

All products share one factorised tangent: S du/de as a matrix costs one solve per observed
degree of freedom, all at once; its products with vectors cost one solve each.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from tactorch.fem import kernels
from tactorch.fem.assembly import Assembly, Response
from tactorch.fem.linearization import Linearization

_CHUNK = 256  # right-hand sides at a time: bounds the memory on large meshes


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """S du/de at one equilibrium, for observed unknowns `observed` (flat indices 3 node + axis)."""

    assembly: Assembly
    response: Response
    tangent: Linearization
    observed: Int[np.ndarray, " p"]

    def matrix(self) -> Float[np.ndarray, "p m"]:
        """Return S du/de, mm/MPa (eq. 13 and 14)."""
        out = np.empty((len(self.observed), self.assembly.discretisation.mesh.n_tets))
        for begin in range(0, len(self.observed), _CHUNK):
            rows = self.observed[begin : begin + _CHUNK]
            rhs = np.zeros((self.tangent.pattern.size, len(rows)), order="F")
            rhs[rows, np.arange(len(rows))] = 1.0
            out[begin : begin + _CHUNK] = -self._unit_work(self.tangent.solve(rhs)).T
        return out

    def times(self, change: Float[np.ndarray, " m"]) -> Float[np.ndarray, " p"]:
        """Return S du/de times a change of the moduli (MPa), mm."""
        return self.displacement_change(change).ravel()[self.observed]

    def displacement_change(self, change: Float[np.ndarray, " m"]) -> Float[np.ndarray, "nodes 3"]:
        """Return du/de times a change of the moduli (MPa) at all nodes, mm."""
        force = np.zeros((self.assembly.discretisation.n_nodes, 3))
        kernels.scatter_forces(
            self.assembly.discretisation.nodes, self.response.forces, change, force
        )
        return -self.tangent.solve(force.ravel()).reshape(-1, 3)

    def transpose_times(self, weights: Float[np.ndarray, " p"]) -> Float[np.ndarray, " m"]:
        """Return the transpose of S du/de times observed weights: the adjoint gradient (eq. 12)."""
        rhs = np.zeros(self.tangent.pattern.size)
        np.add.at(rhs, self.observed, weights)
        return -self._unit_work(self.tangent.solve(rhs)[:, None])[:, 0]

    def _unit_work(self, fields: Float[np.ndarray, "unknowns k"]) -> Float[np.ndarray, "m k"]:
        """Each element's unit force times nodal fields."""
        nodes = self.assembly.discretisation.nodes
        out = np.empty((len(nodes), fields.shape[1]))
        columns = np.ascontiguousarray(fields).reshape(-1, 3, fields.shape[1])
        kernels.gather_dot(nodes, self.response.forces, columns, out)
        return out

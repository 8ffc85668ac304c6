"""How observed displacements answer to Young's moduli (eq. 10 to 14), and to what else there is.

All products share one factorised tangent: S du/de as a matrix costs one solve per observed
degree of freedom, all at once; its products with vectors cost one solve each.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int

from tactorch.fem import kernels, reference
from tactorch.fem.assembly import Assembly, Response
from tactorch.fem.linearization import Linearization

_CHUNK = 256  # right-hand sides at a time: bounds the memory on large meshes


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """S du/de at one equilibrium, for observed unknowns `observed` (flat indices 3 node + axis).

    Attributes:
        assembly: The body.
        response: Its elements at the equilibrium.
        tangent: K there.
        observed: What is observed.
        frame: Rotation into the axes in which displacements are observed; None for the mesh's.
    """

    assembly: Assembly
    response: Response
    tangent: Linearization
    observed: Int[np.ndarray, " p"]
    frame: Float[np.ndarray, "3 3"] | None = None

    def matrix(self) -> Float[np.ndarray, "p m"]:
        """Return S du/de, mm/MPa (eq. 13 and 14)."""
        out = np.empty((len(self.observed), self.assembly.discretisation.mesh.n_tets))
        for begin in range(0, len(self.observed), _CHUNK):
            rows = self.observed[begin : begin + _CHUNK]
            rhs = self._unit_loads(rows)
            out[begin : begin + _CHUNK] = -self._unit_work(self.tangent.solve(rhs)).T
        return out

    def times(self, change: Float[np.ndarray, " m"]) -> Float[np.ndarray, " p"]:
        """Return S du/de times a change of the moduli (MPa), mm."""
        return self.seen(self.displacement_change(change))

    def seen(self, field: Float[np.ndarray, "nodes 3"]) -> Float[np.ndarray, " p"]:
        """Return the observed components of a displacement, mm."""
        return (field if self.frame is None else field @ self.frame.T).ravel()[self.observed]

    def force_response(self, forces: Float[np.ndarray, "k nodes 3"]) -> list[np.ndarray]:
        """Return the displacement by each of k changes of the forces (N), (nodes, 3) mm."""
        if not len(forces):
            return []
        rhs = np.asfortranarray(forces.reshape(len(forces), -1).T)
        return list(np.ascontiguousarray(self.tangent.solve(rhs).T).reshape(forces.shape))

    def displacement_change(self, change: Float[np.ndarray, " m"]) -> Float[np.ndarray, "nodes 3"]:
        """Return du/de times a change of the moduli (MPa) at all nodes, mm."""
        force = np.zeros((self.assembly.discretisation.n_nodes, 3))
        kernels.scatter_forces(
            self.assembly.discretisation.nodes, self.response.forces, change, force
        )
        return -self.tangent.solve(force.ravel()).reshape(-1, 3)

    def transpose_times(self, weights: Float[np.ndarray, " p"]) -> Float[np.ndarray, " m"]:
        """Return the transpose of S du/de times observed weights: the adjoint gradient (eq. 12)."""
        return -self.unit_work(self.adjoint(weights))

    def adjoint(self, weights: Float[np.ndarray, " p"]) -> Float[np.ndarray, "nodes 3"]:
        """Return the displacement by forces that are the observed weights."""
        rhs = np.zeros(self.tangent.pattern.size)
        np.add.at(rhs, self.observed, weights)
        if self.frame is not None:
            rhs = (rhs.reshape(-1, 3) @ self.frame).ravel()
        return self.tangent.solve(rhs).reshape(-1, 3)

    def unit_work(self, field: Float[np.ndarray, "nodes 3"]) -> Float[np.ndarray, " m"]:
        """Return each element's unit force (eq. 11) times a nodal field."""
        return self._unit_work(field.reshape(-1, 1))[:, 0]

    def _unit_loads(self, rows: Int[np.ndarray, " k"]) -> Float[np.ndarray, "unknowns k"]:
        """Loads along each of some observed unknowns."""
        rhs = np.zeros((self.tangent.pattern.size, len(rows)), order="F")
        if self.frame is None:
            rhs[rows, np.arange(len(rows))] = 1.0
        else:
            for axis in range(3):
                rhs[3 * (rows // 3) + axis, np.arange(len(rows))] = self.frame[rows % 3, axis]
        return rhs

    def _unit_work(self, fields: Float[np.ndarray, "unknowns k"]) -> Float[np.ndarray, "m k"]:
        """Each element's unit force times nodal fields."""
        nodes = self.assembly.discretisation.nodes
        out = np.empty((len(nodes), fields.shape[1]))
        columns = np.ascontiguousarray(fields).reshape(-1, 3, fields.shape[1])
        kernels.gather_dot(nodes, self.response.forces, columns, out)
        return out


def force_rates(
    assembly: Assembly,
    u: Float[np.ndarray, "nodes 3"],
    youngs: Float[np.ndarray, " m"],
    *,
    poisson: bool = False,
    stretch: bool = False,
) -> list[Float[np.ndarray, "nodes 3"]]:
    """Return how the elastic forces at a displacement answer to what the material and shape are.

    By differentiating the reference mechanics twice backward: its forward mode is not for threads.

    Args:
        assembly: The body.
        u: Displacement, mm.
        youngs: Moduli, MPa.
        poisson: Whether to give the change by Poisson's ratio, N.
        stretch: Whether to give the changes by the logarithm of the size along x, y and z, N.
    """
    material, discretisation = assembly.material, assembly.discretisation
    ratio = torch.as_tensor(assembly.poisson, dtype=torch.float64).clone().requires_grad_()
    points = torch.tensor(assembly.points, requires_grad=True)
    field, moduli = torch.from_numpy(u), torch.from_numpy(youngs)
    with torch.enable_grad():
        force = reference.internal_force(discretisation, material, field, moduli, ratio, points)
        # The pullback is linear in the forces' weights; its own derivative pushes forward.
        weights = torch.zeros_like(force, requires_grad=True)
        pulled = torch.autograd.grad(force, (ratio, points), weights, create_graph=True)
        changes = [pulled[0].sum()] if poisson else []
        if stretch:
            changes += list((pulled[1] * points).sum(0))
        rates = [torch.autograd.grad(c, weights, retain_graph=True)[0] for c in changes]
    return [rate.numpy() for rate in rates]

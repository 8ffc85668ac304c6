"""Internal forces and tangent of a body at given displacements, on the CPU.

Isotropic materials use the compiled kernels, other materials their stress and tangent tensors.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float

from tactorch.fem import kernels
from tactorch.fem.elements import Discretisation
from tactorch.fem.materials import EnergyDerivatives, IsotropicMaterial, Material


@dataclass(frozen=True, eq=False)
class Response:
    """Energy and forces of all elements per unit modulus, at one displacement field.

    Energy and forces are those of each element (s = 1), or of each quadrature point (s = q) where
    the modulus is given at those.
    """

    F: Float[np.ndarray, "m q 3 3"]  # deformation gradient at the quadrature points
    cofactors: Float[np.ndarray, "m q 3 3"]  # dJ/dF
    invariants: Float[np.ndarray, "3 m q"]  # I1, I2 and J
    energy: Float[np.ndarray, "m s"]  # mm^3
    forces: Float[np.ndarray, "m s k 3"]  # of each element's nodes, mm^2 (the columns of eq. 11)
    derivatives: EnergyDerivatives | None  # without `mean`; None for general materials
    mean: EnergyDerivatives | None  # volumetric energy at the mean J, where it is averaged

    @property
    def smallest_volume_ratio(self) -> tuple[int, float]:
        """Element with the smallest J = det F, and that value."""
        j = self.invariants[2].min(axis=1)
        return int(j.argmin()), float(j.min())


@dataclass(frozen=True, eq=False)
class Assembly:
    """A discretised body of one material."""

    discretisation: Discretisation
    material: Material
    poisson: float | Float[np.ndarray, " m"]
    points: Float[np.ndarray, "n 3"]  # rest positions, mm

    @cached_property
    def _geometry(self) -> tuple[np.ndarray, np.ndarray]:
        gradients, weights = self.discretisation.geometry(torch.tensor(self.points))
        return np.ascontiguousarray(gradients.numpy()), np.ascontiguousarray(weights.numpy())

    @property
    def gradients(self) -> Float[np.ndarray, "m q k 3"]:
        """Shape gradients, 1/mm."""
        return self._geometry[0]

    @property
    def weights(self) -> Float[np.ndarray, "m q"]:
        """Volume of each quadrature point, mm^3."""
        return self._geometry[1]

    @cached_property
    def volumes(self) -> Float[np.ndarray, " m"]:
        """Volume of each element, mm^3."""
        return self.weights.sum(axis=1)

    @property
    def averages_volume(self) -> bool:
        """Whether the volumetric energy is that of the mean volume ratio of each element."""
        mean_dilatation = self.discretisation.element.mean_dilatation
        return mean_dilatation and isinstance(self.material, IsotropicMaterial)

    @property
    def _point_poisson(self) -> float | np.ndarray:
        """Poisson's ratio, in a shape that broadcasts over quadrature points."""
        return self.poisson if np.ndim(self.poisson) == 0 else np.asarray(self.poisson)[:, None]

    def respond(
        self, u: Float[np.ndarray, "nodes 3"], *, per_point: bool = False
    ) -> Response | None:
        """Evaluate all elements; None if the material excludes an inverted one.

        Args:
            u: Displacement, mm.
            per_point: Whether energy and forces are wanted by quadrature point.
        """
        shape = self.weights.shape
        F, cofactors = np.empty((*shape, 3, 3)), np.empty((*shape, 3, 3))
        invariants = np.empty((3, *shape))
        kernels.kinematics(self.discretisation.nodes, self.gradients, u, F, cofactors, invariants)
        if not self.material.allows_inversion and not invariants[2].min() > 0.0:
            return None
        derivatives = mean = None
        if isinstance(self.material, IsotropicMaterial):
            energy, derivatives, mean = self._strain_energy(self.material, invariants)
            first = (derivatives.d1, derivatives.d2, derivatives.dj)
            d1, d2, dj = (np.ascontiguousarray(np.broadcast_to(d, shape)) for d in first)
            sites = shape[1] if per_point else 1
            forces = np.empty((len(F), sites, *self.gradients.shape[2:]))
            kernels.element_forces(
                self.gradients, self.weights, F, cofactors, invariants, d1, d2, dj, forces
            )
            if mean is not None:
                slope = np.broadcast_to(mean.dj, len(F)).copy()
                kernels.add_mean_forces(self.gradients, self.weights, cofactors, slope, forces)
        else:
            gradient, weights = torch.from_numpy(F), torch.from_numpy(self.weights)
            poisson = torch.as_tensor(self._point_poisson, dtype=torch.float64)
            energy = (weights * self.material.energy(gradient, poisson)).numpy()
            stress = weights[..., None, None] * self.material.stress(gradient, poisson)
            forces = (torch.from_numpy(self.gradients) @ stress.mT).numpy()
            if not per_point:
                forces = forces.sum(axis=1, keepdims=True)
        if not per_point:
            energy = energy.sum(axis=1, keepdims=True)
        return Response(F, cofactors, invariants, energy, forces, derivatives, mean)

    def _strain_energy(
        self, material: IsotropicMaterial, invariants: np.ndarray
    ) -> tuple[np.ndarray, EnergyDerivatives, EnergyDerivatives | None]:
        """Energy of each point, its derivatives, and the volumetric part where averaged."""
        i1, i2, j = invariants
        poisson, log_j = self._point_poisson, np.log(j)
        strain = material.strain_derivatives(i1, i2, j, log_j, poisson)
        if self.averages_volume:
            average = (self.weights * j).sum(axis=1) / self.volumes
            mean = material.volumetric_derivatives(average, np.log(average), self.poisson)
            return self.weights * (strain.psi + np.reshape(mean.psi, (-1, 1))), strain, mean
        volume = material.volumetric_derivatives(j, log_j, poisson)
        total = strain._replace(dj=strain.dj + volume.dj, djj=strain.djj + volume.djj)
        return self.weights * (strain.psi + volume.psi), total, None

    def internal_force(
        self, response: Response, youngs: Float[np.ndarray, "m *q"]
    ) -> Float[np.ndarray, "nodes 3"]:
        """Return the assembled nodal elastic forces, N; linear in the moduli (eq. 11)."""
        out = np.zeros((self.discretisation.n_nodes, 3))
        scale = youngs.reshape(response.energy.shape)
        kernels.scatter_forces(self.discretisation.nodes, response.forces, scale, out)
        return out

    def tangent(
        self,
        response: Response,
        youngs: Float[np.ndarray, "m *q"],
        springs: Float[np.ndarray, "nodes 3"] | None = None,
        *,
        project: bool = False,
    ) -> Float[np.ndarray, " nnz"]:
        """Return the upper-triangle values of the tangent, N/mm.

        `springs` (N/mm) act on the nodes; `project` sets the negative eigenvalues of each element
        to zero.
        """
        youngs = youngs.reshape(len(self.weights), -1)
        d, weights = self.discretisation, self.weights * youngs
        if response.derivatives is None:
            values = self._general_blocks(response, weights)
        else:
            # Values of the pattern; to be projected, the entries of each element by itself.
            values, slots = np.zeros(d.pattern.nnz), d.slots
            if project:
                values = np.zeros(d.slots.size)
                slots = np.arange(d.slots.size, dtype=np.int32).reshape(d.slots.shape)
            coefficients = np.empty((9, *weights.shape))
            for row, derivative in zip(coefficients, response.derivatives[1:], strict=True):
                row[...] = derivative
            mean = np.empty(0)
            if response.mean is not None:
                average = weights.sum(axis=1) / self.volumes
                coefficients[2] += np.reshape(response.mean.dj, (-1, 1)) * average[:, None] / youngs
                mean = response.mean.djj * average / self.volumes
            kernels.tangent(
                self.gradients, response.F, response.cofactors, response.invariants, coefficients,
                weights, self.weights, mean, slots, values,
            )  # fmt: skip
        if project:
            values = self._positive_blocks(values.reshape(d.slots.shape))
        if values.ndim == 2:  # assemble the entries of the elements
            values = np.bincount(d.slots.ravel(), values.ravel(), d.pattern.nnz)
        if springs is not None:
            values[d.pattern.diagonal] += springs.ravel()
        return values

    def _general_blocks(
        self, response: Response, weights: np.ndarray
    ) -> Float[np.ndarray, "m entries"]:
        """Upper-triangle entries of the element tangents of a general material."""
        poisson = torch.as_tensor(self._point_poisson, dtype=torch.float64)
        moduli = self.material.tangent(torch.from_numpy(response.F), poisson)
        gradients = torch.from_numpy(self.gradients)
        dense = torch.einsum(
            "mq,mqaI,mqiIjJ,mqbJ->maibj", torch.from_numpy(weights), gradients, moduli, gradients
        ).reshape(len(weights), 3 * gradients.shape[2], -1)
        rows, cols = self.discretisation.entry_rows_cols
        return dense.numpy()[:, rows, cols]

    def _positive_blocks(
        self, entries: Float[np.ndarray, "m entries"]
    ) -> Float[np.ndarray, "m entries"]:
        """Entries of the element tangents with their negative eigenvalues set to zero."""
        rows, cols = self.discretisation.entry_rows_cols
        size = self.discretisation.unknowns.shape[1]
        dense = np.zeros((len(entries), size, size))
        dense[:, rows, cols] = dense[:, cols, rows] = entries
        return positive_part(dense)[:, rows, cols]


def positive_part(blocks: Float[np.ndarray, "m k k"]) -> Float[np.ndarray, "m k k"]:
    """Return symmetric matrices with their negative eigenvalues set to zero."""
    eigenvalues, vectors = np.linalg.eigh(blocks)
    scaled = vectors * np.maximum(eigenvalues, 0.0)[:, None, :]
    return np.asarray(scaled @ vectors.swapaxes(1, 2))

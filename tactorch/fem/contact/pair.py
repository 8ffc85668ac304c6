"""Contact of two parts of one mesh that touch along an axis, with or without slip.

Points of one surface are paired with the points of the other that are opposite to them at rest
(small sliding: P. Wriggers, Computational Contact Mechanics, 2nd ed., 2006, ch. 5). A penalty keeps
paired points from passing each other along the axis, and those that stick from moving across it.
Both are springs between the parts, so that the forces on the parts are opposite and equal.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int

from tactorch.fem.contact.contact import ContactResponse
from tactorch.fem.elements import Discretisation
from tactorch.linalg import SymmetricPattern


@dataclass(frozen=True, eq=False)
class CoupledDiscretisation(Discretisation):
    """Two parts of one mesh, whose tangent couples nodes across a contact."""

    #: Nodes of both parts from which each pair of points is interpolated.
    coupled: Int[np.ndarray, "p k"]

    @cached_property
    def _node_pattern(self) -> SymmetricPattern:
        groups = self.nodes, self.coupled
        pairs = [group.T[np.array(np.triu_indices(group.shape[1]))] for group in groups]
        rows, cols = np.concatenate([pair.reshape(2, -1) for pair in pairs], axis=1)
        return SymmetricPattern.from_pairs(self.n_nodes, rows, cols)


@dataclass(frozen=True, eq=False)
class Pairs:
    """Points of two surfaces that are opposite to each other along z."""

    discretisation: CoupledDiscretisation  # both parts
    #: Shape functions of the nodes `discretisation.coupled`: positive for the first part, negative
    #: for the second.
    values: Float[np.ndarray, "p k"]
    gaps_mm: Float[np.ndarray, " p"]  # z of the first part above that of the second at rest
    areas_mm2: Float[np.ndarray, " p"]  # that each pair stands for
    points: Float[np.ndarray, "p 3"]  # of the second part at rest, mm

    @cached_property
    def entries(self) -> tuple[Int[np.ndarray, "3 p e"], Float[np.ndarray, "p e"]]:
        """Slots in the pattern of pairs of nodes along each axis, and their products of values."""
        a, b = np.triu_indices(self.values.shape[1])
        first, second = self.discretisation.coupled[:, a], self.discretisation.coupled[:, b]
        pattern = self.discretisation.pattern
        slots = np.stack([pattern.slots(3 * first + i, 3 * second + i) for i in range(3)])
        return slots, self.values[:, a] * self.values[:, b]

    def spread(self, at_pairs: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, "nodes 3"]:
        """Return nodal forces from forces at pairs, on the first part and against the second."""
        forces = np.zeros((self.discretisation.n_nodes, 3))
        spread = self.values[:, :, None] * at_pairs[:, None, :]
        np.add.at(forces, self.discretisation.coupled, spread)
        return forces


@dataclass(frozen=True, eq=False)
class PairContact:
    """Contact of paired points."""

    pairs: Pairs
    #: Motion of the second part as a whole, which its displacement does not contain.
    motion_mm: Float[np.ndarray, "3"]
    stiffness: float  # pressure per penetration, and traction per slip, MPa/mm
    sticking: Bool[np.ndarray, " p"]  # pairs that do not slip

    def moved(self, load: float) -> "PairContact":
        """Return the contact at a fraction of the motion."""
        return self if load == 1.0 else replace(self, motion_mm=load * self.motion_mm)

    def pushes_ahead(self, u: Float[np.ndarray, "nodes 3"]) -> bool:
        """Whether the full motion can be tried at once: always, as the axis is fixed."""
        return True

    def offsets(self, u: Float[np.ndarray, "nodes 3"]) -> Float[np.ndarray, "p 3"]:
        """Return the offset of the first part from the second at each pair, mm.

        Components along x and y are the slip since rest, that along z is the gap.
        """
        pairs = self.pairs
        moved = np.einsum("pk,pki->pi", pairs.values, u[pairs.discretisation.coupled])
        moved -= self.motion_mm
        moved[:, 2] += pairs.gaps_mm
        return moved

    def pair_forces(self, u: Float[np.ndarray, "nodes 3"]) -> Float[np.ndarray, "p 3"]:
        """Return the force of the second part on the first at each pair, N."""
        return -self.springs(u) * self.offsets(u)

    def springs(self, u: Float[np.ndarray, "nodes 3"]) -> Float[np.ndarray, "p 3"]:
        """Return the stiffness of each pair along each axis at displacements (mm), N/mm."""
        return self._springs(self.offsets(u)[:, 2] < 0.0)

    def energy(self, u: Float[np.ndarray, "nodes 3"]) -> float:
        """Return the energy at displacements (mm), N mm."""
        offsets = self.offsets(u)
        return 0.5 * float((self._springs(offsets[:, 2] < 0.0) * offsets**2).sum())

    def at(self, u: Float[np.ndarray, "nodes 3"]) -> ContactResponse:
        """Return energy, nodal forces and total at displacements (mm).

        `rows` are the pairs in contact, whose blocks are not needed.
        """
        offsets = self.offsets(u)
        touching = offsets[:, 2] < 0.0
        springs = self._springs(touching)
        energy, at_pairs = 0.5 * float((springs * offsets**2).sum()), springs * offsets
        none = np.zeros((int(touching.sum()), 0, 0))
        forces, total = self.pairs.spread(at_pairs), at_pairs.sum(axis=0)
        return ContactResponse(energy, forces, np.flatnonzero(touching), none, total)

    def add_tangent(
        self, values: Float[np.ndarray, " nnz"], response: ContactResponse, *, project: bool = False
    ) -> None:
        """Add the tangent of the contact, which is positive semi-definite, in place, N/mm."""
        springs, (slots, products) = self._springs(response.rows), self.pairs.entries
        for axis in range(3):
            rows = np.flatnonzero(springs[:, axis])
            added = springs[rows, axis, None] * products[rows]
            values += np.bincount(slots[axis, rows].ravel(), added.ravel(), len(values))

    def tangent(self, response: ContactResponse) -> sp.csr_matrix:
        """Return the second derivative of the energy by all displacements, N/mm."""
        parts = self.pairs.discretisation
        count, k = parts.coupled.shape
        entries = self.pairs.values.ravel(), parts.coupled.ravel(), np.arange(count + 1) * k
        offsets = sp.csr_matrix(entries, shape=(count, parts.n_nodes))
        by_axis = sp.kron(offsets, sp.identity(3))
        stiff = sp.diags(self._springs(response.rows).ravel())
        return sp.csr_matrix(by_axis.T @ stiff @ by_axis)

    def _springs(self, touching: np.ndarray) -> Float[np.ndarray, "p 3"]:
        """Stiffness of each pair along each axis, N/mm; along z of those that touch."""
        kept = np.tile(self.sticking[:, None], 3)
        kept[:, 2] = False
        kept[touching, 2] = True
        return np.asarray(self.stiffness * self.pairs.areas_mm2[:, None] * kept)

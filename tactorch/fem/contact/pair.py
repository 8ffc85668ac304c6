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
    """Two parts of one mesh, whose tangent couples nodes across a contact.

    Attributes:
        coupled: Nodes of both parts from which each pair of points is interpolated, (p, k).
    """

    coupled: Int[np.ndarray, "p k"]

    @cached_property
    def _node_pattern(self) -> SymmetricPattern:
        first, second = self._local_pairs
        a, b = np.triu_indices(self.coupled.shape[1])
        rows = np.concatenate([self.nodes[:, first].ravel(), self.coupled[:, a].ravel()])
        cols = np.concatenate([self.nodes[:, second].ravel(), self.coupled[:, b].ravel()])
        return SymmetricPattern.from_pairs(self.n_nodes, rows, cols)


@dataclass(frozen=True, eq=False)
class Pairs:
    """Points of two surfaces that are opposite to each other along z.

    Attributes:
        discretisation: Both parts.
        values: Shape functions of the nodes `discretisation.coupled`, (p, k): positive for the
            first part, negative for the second.
        gaps_mm: z of the first part above that of the second at rest, (p,).
        areas_mm2: Area that each pair stands for, (p,).
    """

    discretisation: CoupledDiscretisation
    values: Float[np.ndarray, "p k"]
    gaps_mm: Float[np.ndarray, " p"]
    areas_mm2: Float[np.ndarray, " p"]

    @cached_property
    def entries(self) -> tuple[Int[np.ndarray, "3 p e"], Float[np.ndarray, "p e"]]:
        """Slots in the pattern of pairs of nodes along each axis, and their products of values."""
        a, b = np.triu_indices(self.values.shape[1])
        first, second = self.discretisation.coupled[:, a], self.discretisation.coupled[:, b]
        pattern = self.discretisation.pattern
        slots = np.stack([pattern.slots(3 * first + i, 3 * second + i) for i in range(3)])
        return slots, self.values[:, a] * self.values[:, b]


@dataclass(frozen=True, eq=False)
class PairContact:
    """Contact of paired points.

    Attributes:
        pairs: The points.
        motion_mm: Motion of the second part as a whole, which its displacement does not contain.
        stiffness: Pressure per penetration, and traction per slip, MPa/mm.
        sticking: Pairs that do not slip, (p,).
    """

    pairs: Pairs
    motion_mm: Float[np.ndarray, "3"]
    stiffness: float
    sticking: Bool[np.ndarray, " p"]

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
        offsets = self.offsets(u)
        return -self._springs(offsets[:, 2] < 0.0) * offsets

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
        forces = np.zeros_like(u)
        spread = self.pairs.values[:, :, None] * at_pairs[:, None, :]
        np.add.at(forces, self.pairs.discretisation.coupled, spread)
        none = np.zeros((int(touching.sum()), 0, 0))
        return ContactResponse(energy, forces, np.flatnonzero(touching), none, at_pairs.sum(axis=0))

    def add_tangent(
        self, values: Float[np.ndarray, " nnz"], response: ContactResponse, *, project: bool = False
    ) -> None:
        """Add the tangent of the contact, which is positive semi-definite, in place, N/mm."""
        touching = np.zeros(len(self.sticking), dtype=bool)
        touching[response.rows] = True
        springs, (slots, products) = self._springs(touching), self.pairs.entries
        for axis in range(3):
            rows = np.flatnonzero(springs[:, axis])
            added = springs[rows, axis, None] * products[rows]
            values += np.bincount(slots[axis, rows].ravel(), added.ravel(), len(values))

    def tangent(self, response: ContactResponse) -> sp.csr_matrix:
        """Return the second derivative of the energy by all displacements, N/mm."""
        parts = self.pairs.discretisation
        touching = np.zeros(len(self.sticking), dtype=bool)
        touching[response.rows] = True
        rows = np.repeat(np.arange(len(touching)), parts.coupled.shape[1])
        entries = self.pairs.values.ravel(), (rows, parts.coupled.ravel())
        offsets = sp.csr_matrix(entries, shape=(len(touching), parts.n_nodes))
        by_axis = sp.kron(offsets, sp.identity(3))
        stiff = sp.diags(self._springs(touching).ravel())
        return sp.csr_matrix(by_axis.T @ stiff @ by_axis)

    def _springs(self, touching: Bool[np.ndarray, " p"]) -> Float[np.ndarray, "p 3"]:
        """Stiffness of each pair along each axis, N/mm."""
        kept = np.column_stack([self.sticking, self.sticking, touching])
        scaled: np.ndarray = self.stiffness * self.pairs.areas_mm2[:, None] * kept
        return scaled

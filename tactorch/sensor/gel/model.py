"""Contact forces on a gel from how its outer face moved (Section III-B, last paragraph).

The gel's own elasticity is known, so at equilibrium the forces on its face are those that its
deformation takes. Where displacements are noisy that amplifies the noise: forces are then those
that are smooth and explain the displacements, see `tactorch.sensor.gel.smooth`.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from tactorch.errors import ConfigError
from tactorch.fem import (
    EquilibriumResult,
    Linearization,
    Newton,
    NewtonOptions,
    SoftBody,
    Supports,
    make_material,
)
from tactorch.mesh.values import Real
from tactorch.sensor.description import GelLayer
from tactorch.sensor.gel.contact import Contact
from tactorch.sensor.gel.face import GelFace
from tactorch.sensor.gel.mesh import GelMesh, gel_mesh
from tactorch.sensor.gel.smooth import Roughness, Smoothed, smoothed

_BALANCED = 1e-8  # residual force, relative
_ROUNDS = 8  # of linearising
_SETTLED = 1e-3  # relative change of the forces
_LINEAR = 0.1  # of the noise: what the linearisation may be off by at the end
# The gel is linearised anew where the linearisation is off by more than this of the displacement,
# or by more than this of what it was off by before.
_BENT, _FALLS = 0.05, 0.3


@dataclass(frozen=True, eq=False)
class _State:
    """An equilibrium of the gel, and its tangent."""

    moved: Float[np.ndarray, "nodes 3"]
    search: Newton
    found: EquilibriumResult

    @cached_property
    def tangent(self) -> Linearization:
        return self.search.linearize(self.found)


class GelModel:
    """A gel that can be asked for the forces behind a deformation.

    Args:
        gel: The soft layer.
        edge_mm: Of a cell on the outer face.
        layers: Of cells through the thickness.
        element: "tet10", which does not lock where the gel keeps its volume, or "tet4", which is
            fast but takes a gel of Poisson's ratio 0.49 for stiffer by a tenth and more.

    Raises:
        ConfigError: A value cannot be used.
    """

    def __init__(
        self, gel: GelLayer, edge_mm: Real = 1.0, layers: int = 4, element: str = "tet10"
    ) -> None:
        self.gel = gel
        self.meshed: GelMesh = gel_mesh(gel, edge_mm, layers)
        law = make_material(
            gel.material_spec.name, gel.material_spec.poisson, **gel.material_spec.parameters
        )
        newton = NewtonOptions(rtol=_BALANCED)
        self.body = SoftBody(self.meshed.mesh, law, element=element, newton=newton)
        self.face = GelFace(self.meshed, self.body)
        self._kept: dict[int, np.ndarray] = {}  # compliance at rest by node, mm/N

    @property
    def points(self) -> Float[np.ndarray, "k 3"]:
        """Rest positions of the outer face's nodes, mm."""
        return self.meshed.face_points

    @property
    def youngs(self) -> Float[np.ndarray, " m"]:
        """Young's modulus of each element, MPa."""
        return np.full(self.meshed.mesh.n_tets, float(self.gel.youngs_mpa))

    def forces(
        self, displacement: Float[np.ndarray, "k 3"], noise_mm: Real | None = None
    ) -> Contact:
        """Return the forces that hold the outer face displaced exactly so.

        Args:
            displacement: Of the face's nodes, mm; NaN where it is free.
            noise_mm: Standard deviation of the displacements, mm, for the total's covariance.

        Raises:
            ConfigError: The shape is wrong, or nothing is known.
            ConvergenceError: The gel collapses.
        """
        known = self._known(displacement)
        supports = self._held(np.nan_to_num(displacement), known)
        nothing = np.zeros(self.meshed.mesh.points.shape)
        search = self.body.search(self.youngs, nothing, supports)
        found = search.run().require()
        assert found.response is not None
        inner = self.body.assembly.internal_force(found.response, self.youngs)
        at_face = np.where(known, self.face.at_nodes(inner), 0.0)
        covariance = None
        if noise_mm is not None:
            rates = self._total_rates(_State(found.displacement, search, found), known)
            covariance = float(noise_mm) ** 2 * rates @ rates.T
        return Contact(self.points, found.displacement[self.meshed.face], at_face, covariance)

    def smooth_forces(
        self,
        displacement: Float[np.ndarray, "k 3"],
        noise_mm: Real,
        touched: Bool[np.ndarray, " k"] | None = None,
        *,
        tilted: bool = False,
    ) -> Contact:
        """Return the smooth forces that the displacements make likeliest.

        Args:
            displacement: Of the face's nodes, mm; NaN where it was not seen.
            noise_mm: Standard deviation of the displacements, mm, at least; where they show more,
                that counts.
            touched: Nodes that may bear a force; None for all. The total force of a gel that keeps
                its volume is told far better where this is known.
            tilted: Whether displacements along z are known but for a constant and a tilt, as
                depth from slopes is. What the gel does around the contact then tells them.

        Raises:
            ConfigError: The shape is wrong, or nothing is known, or nothing is touched.
            ConvergenceError: The gel collapses.
        """
        seen = self._known(displacement)
        may = np.ones(len(self.points), dtype=bool) if touched is None else touched
        if not may.any():
            raise ConfigError("touched is false at every node; without contact there is no force.")
        prior = Roughness.between(self.face.edges(may), self.face.areas[may])
        plane = self._plane()[seen.ravel()] if tilted else np.zeros((int(seen.sum()), 0))
        forces, state = np.zeros((len(self.points), 3)), self._rest
        bent, compliance, last = state, self._rest_compliance(may), np.inf
        for _ in range(_ROUNDS):
            moved = state.moved[self.meshed.face]
            off = (np.nan_to_num(displacement) - moved)[seen]
            seen_compliance = compliance[seen.ravel()]
            wanted = off + seen_compliance @ forces[may].ravel()
            found = smoothed(seen_compliance, plane, wanted, prior, float(noise_mm))
            change = np.zeros_like(forces)
            change[may] = found.forces.reshape(-1, 3) - forces[may]
            forces = forces + change
            told = state.moved + bent.tangent.solve(self._loads(change).ravel()).reshape(-1, 3)
            state = self._under(forces, told, None if state is bent else state)
            missed = _rms((state.moved - told)[self.meshed.face])
            if missed <= _LINEAR * found.noise_mm or _rms(change) <= _SETTLED * _rms(forces):
                break
            if missed > min(_BENT * _rms(state.moved[self.meshed.face]), _FALLS * last):
                bent, compliance = state, self._compliance(state, may)
            last = missed
        return self._smooth_contact(state, forces, found)

    def _smooth_contact(
        self, state: _State, forces: Float[np.ndarray, "k 3"], found: Smoothed
    ) -> Contact:
        moved = state.moved[self.meshed.face]
        return Contact(self.points, moved, forces, found.total_covariance)

    @cached_property
    def _rest(self) -> _State:
        return self._under(np.zeros((len(self.points), 3)))

    def _loads(self, forces: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "nodes 3"]:
        return np.asarray(self.face.load_matrix @ forces)

    def _under(
        self,
        forces: Float[np.ndarray, "k 3"],
        start: Float[np.ndarray, "nodes 3"] | None = None,
        after: _State | None = None,
    ) -> _State:
        """The gel under forces on its face; a state before it hands its factorisation on."""
        supports = self._held(np.zeros(forces.shape), np.zeros(forces.shape, dtype=bool))
        before = None if after is None else after.search
        search = self.body.search(self.youngs, self._loads(forces), supports, after=before)
        found = search.run(start).require()
        return _State(found.displacement, search, found)

    def _rest_compliance(self, may: Bool[np.ndarray, " k"]) -> Float[np.ndarray, "k3 f"]:
        """The compliance at rest, kept from one call to the next: presses touch much the same."""
        nodes = np.flatnonzero(may).tolist()
        new = [i for i in nodes if i not in self._kept]
        if new:
            of_new = np.zeros(len(may), dtype=bool)
            of_new[new] = True
            columns = self._compliance(self._rest, of_new)
            self._kept.update(zip(new, np.split(columns, len(new), axis=1), strict=True))
        return np.hstack([self._kept[i] for i in nodes])

    def _compliance(self, state: _State, may: Bool[np.ndarray, " k"]) -> Float[np.ndarray, "k3 f"]:
        """By how much more the face moves under unit forces on the chosen nodes."""
        solved = state.tangent.solve(self.face.unit_loads(may))
        face = self.meshed.face
        return solved.reshape(self.body.n_nodes, 3, -1)[face].reshape(3 * len(face), -1)

    def _total_rates(
        self, state: _State, known: Bool[np.ndarray, "k 3"]
    ) -> Float[np.ndarray, "3 known"]:
        """How the total force answers to the prescribed displacements.

        The tangent is symmetric: these are the forces on the face where all that is known of it
        moves along an axis.
        """
        assert state.found.response is not None
        values = self.body.assembly.tangent(state.found.response, self.youngs)
        pattern, extend = self.body.discretisation.pattern, self.body.discretisation.extend
        rows = []
        for axis in range(3):
            along = np.zeros(known.shape)
            along[:, axis] = 1.0
            moved = np.zeros(self.meshed.mesh.points.shape)
            moved[self.meshed.face] = np.where(known, along, 0.0)
            jump = np.where(state.search.supports.fixed, extend(moved), 0.0).ravel()
            move = jump - state.tangent.solve(pattern.product(values, jump))
            answer = pattern.product(values, move).reshape(-1, 3)
            rows.append(self.face.at_nodes(answer)[known])
        return np.stack(rows)

    def _plane(self) -> Float[np.ndarray, "k3 3"]:
        """Displacements along z of a constant and of two tilts, over the face."""
        found = np.zeros((len(self.points), 3, 3))
        found[:, 2, 0] = 1.0
        found[:, 2, 1:] = self.points[:, :2] / np.abs(self.points[:, :2]).max(axis=0)
        return found.reshape(-1, 3)

    def _held(
        self, displacement: Float[np.ndarray, "k 3"], known: Bool[np.ndarray, "k 3"]
    ) -> Supports:
        shape = self.meshed.mesh.points.shape
        fixed, prescribed = np.zeros(shape, dtype=bool), np.zeros(shape)
        fixed[self.meshed.window] = True
        fixed[self.meshed.face] |= known
        prescribed[self.meshed.face] = np.where(known, displacement, 0.0)
        prescribed[self.meshed.window] = 0.0
        return Supports(fixed=fixed, prescribed=prescribed)

    def _known(self, displacement: Float[np.ndarray, "k 3"]) -> Bool[np.ndarray, "k 3"]:
        if displacement.shape != self.points.shape:
            raise ConfigError(
                f"displacement has shape {displacement.shape}; expected {self.points.shape}, one"
                " row for each node of the gel's outer face."
            )
        known = np.asarray(np.isfinite(displacement))
        if not known.any():
            raise ConfigError("no displacement of the gel is known.")
        return known


def _rms(values: Float[np.ndarray, "k 3"]) -> float:
    return float(np.sqrt(np.mean(values**2)))

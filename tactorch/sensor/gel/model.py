"""Contact forces on a gel from the displacement of its outer face (Section III-B, last paragraph).

The gel's elasticity is known, so at equilibrium its deformation determines the forces on its face.
This amplifies noise of the displacements. `GelModel.smooth_forces` therefore finds the smooth
forces that explain the displacements, see `tactorch.sensor.gel.smoothing`.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from tactorch.config import Options, option
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
from tactorch.sensor.gel.mesh import FaceLoads, GelMesh, build_gel_mesh
from tactorch.sensor.gel.smoothing import Roughness, SmoothForces, fit_smooth_forces

_NEWTON_RTOL = 1e-8
_MAX_LINEARIZATIONS = 8
_FORCE_RTOL = 1e-3  # change of the forces at convergence
_NOISE_FRACTION = 0.1  # acceptable linearization error, relative to the noise
# The gel is linearized again if the linearization error exceeds this fraction of the displacement,
# or of the error in the previous iteration.
_DISPLACEMENT_FRACTION, _ERROR_DECREASE = 0.05, 0.3


@dataclass(frozen=True)
class GelOptions(Options):
    """Discretization of the gel."""

    edge_mm: float = option(1.0, "Edge length of the gel's cells on its face", unit="mm", gt=0)
    layers: int = option(4, "Number of cells through the gel", ge=1)
    element: Literal["tet10", "tet4"] = option(
        "tet10",
        "Element: tet10, free of locking (seconds per frame), or tet4, fast but too stiff near"
        " incompressibility",
    )


@dataclass(frozen=True, eq=False)
class GelContact:
    """Forces on the outer face of a gel, in the sensor frame.

    Attributes:
        points: Rest positions of the nodes of the face, (k, 3), mm.
        displacement: Displacements of the nodes, (k, 3), mm; smoothed if noise was given.
        forces: Forces on the gel at each node, (k, 3), N; the object experiences the opposite.
        covariance: Covariance of the total force due to the noise of the displacements, (3, 3),
            N^2; None if no noise was given.
    """

    points: Float[np.ndarray, "k 3"]
    displacement: Float[np.ndarray, "k 3"]
    forces: Float[np.ndarray, "k 3"]
    covariance: Float[np.ndarray, "3 3"] | None = None

    @property
    def total(self) -> Float[np.ndarray, "3"]:
        """Sum of the forces, N."""
        return self.forces.sum(axis=0)


@dataclass(frozen=True, eq=False)
class _State:
    """Equilibrium of the gel, and its tangent."""

    displacement: Float[np.ndarray, "nodes 3"]
    newton: Newton
    equilibrium: EquilibriumResult

    @cached_property
    def tangent(self) -> Linearization:
        return self.newton.linearize(self.equilibrium)


class GelModel:
    """Finite element model of a gel that computes the forces behind a deformation.

    Args:
        gel: Gel layer.
        edge_mm: Edge length of a cell on the outer face.
        layers: Number of cells through the thickness.
        element: "tet10", which does not lock near incompressibility, or "tet4", which is fast but
            at a Poisson's ratio of 0.49 too stiff by 10 % and more.

    Raises:
        ConfigError: A value cannot be used.
    """

    def __init__(
        self, gel: GelLayer, edge_mm: Real = 1.0, layers: int = 4, element: str = "tet10"
    ) -> None:
        self.gel = gel
        self.gel_mesh: GelMesh = build_gel_mesh(gel, edge_mm, layers)
        spec = gel.material_spec
        law = make_material(spec.name, spec.poisson, **spec.parameters)
        newton = NewtonOptions(rtol=_NEWTON_RTOL)
        self.body = SoftBody(self.gel_mesh.mesh, law, element=element, newton=newton)
        self.loads = FaceLoads(self.gel_mesh, self.body)
        self._rest_columns: dict[int, np.ndarray] = {}  # compliance at rest by node, mm/N

    @classmethod
    def build(cls, gel: GelLayer, options: GelOptions | None = None) -> "GelModel":
        """Make a model with typed settings."""
        options = options or GelOptions()
        return cls(gel, options.edge_mm, options.layers, options.element)

    @property
    def points(self) -> Float[np.ndarray, "k 3"]:
        """Rest positions of the nodes of the outer face, mm."""
        return self.gel_mesh.face_points

    @property
    def youngs(self) -> Float[np.ndarray, " m"]:
        """Young's modulus of each element, MPa."""
        return np.full(self.gel_mesh.mesh.n_tets, float(self.gel.youngs_mpa))

    def forces(
        self, displacement: Float[np.ndarray, "k 3"], noise_mm: Real | None = None
    ) -> GelContact:
        """Return the forces for exactly prescribed displacements of the outer face.

        Args:
            displacement: Displacements of the nodes of the face, mm; NaN where the face is free.
            noise_mm: Standard deviation of the displacements, mm, for the covariance of the total.

        Returns:
            The forces.

        Raises:
            ConfigError: The shape is wrong, or no displacement is known.
            ConvergenceError: Newton's method does not converge.
        """
        known = self._known(displacement)
        supports = self._supports(np.nan_to_num(displacement), known)
        no_load = np.zeros(self.gel_mesh.mesh.points.shape)
        newton = self.body.search(self.youngs, no_load, supports)
        equilibrium = newton.run().require()
        assert equilibrium.response is not None
        internal = self.body.assembly.internal_force(equilibrium.response, self.youngs)
        forces = np.where(known, self.loads.gather(internal), 0.0)
        covariance = None
        if noise_mm is not None:
            state = _State(equilibrium.displacement, newton, equilibrium)
            sensitivity = self._total_force_sensitivity(state, known)
            covariance = float(noise_mm) ** 2 * sensitivity @ sensitivity.T
        return GelContact(
            self.points, equilibrium.displacement[self.gel_mesh.face], forces, covariance
        )

    def smooth_forces(
        self,
        displacement: Float[np.ndarray, "k 3"],
        noise_mm: Real,
        contact: Bool[np.ndarray, " k"] | None = None,
        *,
        free_plane: bool = False,
    ) -> GelContact:
        """Return the most likely smooth forces for noisy displacements of the outer face.

        Args:
            displacement: Displacements of the nodes of the face, mm; NaN where unknown.
            noise_mm: Lower bound of the standard deviation of the displacements, mm; a larger one
                is estimated from the displacements.
            contact: Nodes that may carry a force; None for all. For a nearly incompressible gel,
                knowing them makes the total force far more accurate.
            free_plane: Whether displacements along z are known up to a constant and a tilt, as
                depth from slopes is. Both are then determined by the gel around the contact.

        Returns:
            The forces.

        Raises:
            ConfigError: The shape is wrong, or no displacement or no contact is known.
            ConvergenceError: Newton's method does not converge.
        """
        known = self._known(displacement)
        loaded = np.ones(len(self.points), dtype=bool) if contact is None else contact
        if not loaded.any():
            raise ConfigError("contact is false at every node; without contact there is no force.")
        prior = Roughness.from_edges(self.loads.edges(loaded), self.gel_mesh.face_areas[loaded])
        rows = known.ravel()
        plane = self._plane_modes()[rows] if free_plane else np.zeros((int(known.sum()), 0))
        forces, state = np.zeros((len(self.points), 3)), self._rest
        linearized, compliance, last_error = state, self._rest_compliance(loaded), np.inf
        for _ in range(_MAX_LINEARIZATIONS):
            current = state.displacement[self.gel_mesh.face]
            residual = (np.nan_to_num(displacement) - current)[known]
            target = residual + compliance[rows] @ forces[loaded].ravel()
            fit = fit_smooth_forces(compliance[rows], plane, target, prior, float(noise_mm))
            change = np.zeros_like(forces)
            change[loaded] = fit.forces.reshape(-1, 3) - forces[loaded]
            forces = forces + change
            linear_step = linearized.tangent.solve(self._face_load(change).ravel()).reshape(-1, 3)
            predicted = state.displacement + linear_step
            state = self._equilibrium(forces, predicted, None if state is linearized else state)
            error = _rms((state.displacement - predicted)[self.gel_mesh.face])
            converged = _rms(change) <= _FORCE_RTOL * _rms(forces)
            if error <= _NOISE_FRACTION * fit.noise_mm or converged:
                break
            size = _rms(state.displacement[self.gel_mesh.face])
            if error > min(_DISPLACEMENT_FRACTION * size, _ERROR_DECREASE * last_error):
                linearized, compliance = state, self._compliance(state, loaded)
            last_error = error
        return self._smooth_contact(state, forces, fit)

    def _smooth_contact(
        self, state: _State, forces: Float[np.ndarray, "k 3"], fit: SmoothForces
    ) -> GelContact:
        displacement = state.displacement[self.gel_mesh.face]
        return GelContact(self.points, displacement, forces, fit.total_covariance)

    @cached_property
    def _rest(self) -> _State:
        return self._equilibrium(np.zeros((len(self.points), 3)))

    def _face_load(self, forces: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "nodes 3"]:
        return np.asarray(self.loads.load_matrix @ forces)

    def _equilibrium(
        self,
        forces: Float[np.ndarray, "k 3"],
        start: Float[np.ndarray, "nodes 3"] | None = None,
        previous: _State | None = None,
    ) -> _State:
        """Equilibrium under forces on the face; the factorization of a previous state is reused."""
        supports = self._supports(np.zeros(forces.shape), np.zeros(forces.shape, dtype=bool))
        after = None if previous is None else previous.newton
        newton = self.body.search(self.youngs, self._face_load(forces), supports, after=after)
        equilibrium = newton.run(start).require()
        return _State(equilibrium.displacement, newton, equilibrium)

    def _rest_compliance(self, loaded: Bool[np.ndarray, " k"]) -> Float[np.ndarray, "k3 f"]:
        """Compliance at rest; columns are cached, since presses load similar nodes."""
        nodes = np.flatnonzero(loaded).tolist()
        missing = [i for i in nodes if i not in self._rest_columns]
        if missing:
            selected = np.zeros(len(loaded), dtype=bool)
            selected[missing] = True
            columns = np.split(self._compliance(self._rest, selected), len(missing), axis=1)
            self._rest_columns.update(zip(missing, columns, strict=True))
        return np.hstack([self._rest_columns[i] for i in nodes])

    def _compliance(
        self, state: _State, loaded: Bool[np.ndarray, " k"]
    ) -> Float[np.ndarray, "k3 f"]:
        """Displacement of the face under unit forces on the loaded nodes."""
        solution = state.tangent.solve(self.loads.unit_loads(loaded))
        face = self.gel_mesh.face
        return solution.reshape(self.body.n_nodes, 3, -1)[face].reshape(3 * len(face), -1)

    def _total_force_sensitivity(
        self, state: _State, known: Bool[np.ndarray, "k 3"]
    ) -> Float[np.ndarray, "3 known"]:
        """Derivative of the total force with respect to the prescribed displacements.

        The tangent is symmetric: these are the forces on the face when all its known components
        move along an axis.
        """
        assert state.equilibrium.response is not None
        values = self.body.assembly.tangent(state.equilibrium.response, self.youngs)
        pattern, extend = self.body.discretisation.pattern, self.body.discretisation.extend
        rows = []
        for axis in range(3):
            along = np.zeros(known.shape)
            along[:, axis] = 1.0
            moved = np.zeros(self.gel_mesh.mesh.points.shape)
            moved[self.gel_mesh.face] = np.where(known, along, 0.0)
            prescribed = np.where(state.newton.supports.fixed, extend(moved), 0.0).ravel()
            total = prescribed - state.tangent.solve(pattern.product(values, prescribed))
            reaction = pattern.product(values, total).reshape(-1, 3)
            rows.append(self.loads.gather(reaction)[known])
        return np.stack(rows)

    def _plane_modes(self) -> Float[np.ndarray, "k3 3"]:
        """Displacements of the face along z: a constant and two tilts."""
        modes = np.zeros((len(self.points), 3, 3))
        modes[:, 2, 0] = 1.0
        modes[:, 2, 1:] = self.points[:, :2] / np.abs(self.points[:, :2]).max(axis=0)
        return modes.reshape(-1, 3)

    def _supports(
        self, displacement: Float[np.ndarray, "k 3"], known: Bool[np.ndarray, "k 3"]
    ) -> Supports:
        shape = self.gel_mesh.mesh.points.shape
        fixed, prescribed = np.zeros(shape, dtype=bool), np.zeros(shape)
        fixed[self.gel_mesh.window] = True
        fixed[self.gel_mesh.face] |= known
        prescribed[self.gel_mesh.face] = np.where(known, displacement, 0.0)
        prescribed[self.gel_mesh.window] = 0.0
        return Supports(fixed=fixed, prescribed=prescribed)

    def _known(self, displacement: Float[np.ndarray, "k 3"]) -> Bool[np.ndarray, "k 3"]:
        if displacement.shape != self.points.shape:
            raise ConfigError(
                f"displacement has shape {displacement.shape}; expected {self.points.shape}, one"
                " row for each node of the gel's outer face."
            )
        known = np.asarray(np.isfinite(displacement))
        if not known.any():
            raise ConfigError("no displacement of the gel is known; give the shape of its face.")
        return known


def _rms(values: Float[np.ndarray, "k 3"]) -> float:
    return float(np.sqrt(np.mean(values**2)))

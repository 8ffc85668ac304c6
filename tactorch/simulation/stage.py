"""The body that is pressed: its mesh, loads and supports, and the displacements it answers with."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from tactorch.errors import ConfigError, ConvergenceError
from tactorch.fem import ELEMENTS, Discretisation, SoftBody, Supports
from tactorch.fem.loads import pressure_forces
from tactorch.mesh import TetMesh, face_nodes
from tactorch.simulation.hold import fixed_freedoms, foundation, spring_stiffness
from tactorch.simulation.patch import nodes_within, patch_forces
from tactorch.simulation.plan import PressPlan, Series
from tactorch.simulation.transfer import Transfer

# Total forces on two meshes of one curved body may differ by this share; they are made equal.
_FORCE_MISMATCH = 0.05


@dataclass(frozen=True, eq=False)
class Setup:
    """One series as the recording has it, over the n nodes of its mesh.

    Attributes:
        series: Where it presses.
        forces: Nodal forces of a pressure of 1 MPa, N.
        observed: All three components of the pressed nodes.
        springs: Stiffness of the springs, N/mm.
        fixed: Degrees of freedom held exactly.
    """

    series: Series
    forces: Float[np.ndarray, "n 3"]
    observed: Bool[np.ndarray, "n 3"]
    springs: Float[np.ndarray, "n 3"]
    fixed: Bool[np.ndarray, "n 3"]

    @classmethod
    def on(cls, mesh: TetMesh, series: Series, plan: PressPlan, *, even: bool) -> "Setup":
        """Set a series up on the recording's mesh, its springs even by area or one like another.

        Raises:
            ConfigError: The patch misses the object or all nodes.
            MeshError: The object has no such flat side.
        """
        nodes = face_nodes(mesh, series.face)
        if plan.patch_radius_mm is not None:
            nodes = nodes_within(mesh, nodes, series, plan.patch_radius_mm)
        observed = np.zeros((mesh.n_points, 3), dtype=bool)
        observed[nodes] = True
        return cls(
            series,
            unit_forces(Discretisation(mesh, ELEMENTS["tet4"]), series, plan),
            observed,
            spring_stiffness(mesh, series, plan, even=even),
            fixed_freedoms(mesh, series, plan),
        )


def unit_forces(
    discretisation: Discretisation, series: Series, plan: PressPlan
) -> Float[np.ndarray, "nodes 3"]:
    """Return the consistent nodal forces of 1 MPa on the side or its patch, N."""
    if plan.patch_radius_mm is not None:
        return patch_forces(discretisation, series, plan.patch_radius_mm)
    return pressure_forces(discretisation, series.face, 1.0).numpy()


@dataclass(frozen=True, eq=False)
class Stage:
    """A soft body that may be on a finer mesh than the recording.

    Attributes:
        body: What is pressed.
        youngs: Its moduli, MPa.
        mesh: The recording's mesh.
        plan: The presses.
        weight: Nodal forces of gravity, N.
    """

    body: SoftBody
    youngs: Float[np.ndarray, " e"]
    mesh: TetMesh
    plan: PressPlan
    weight: Float[np.ndarray, "nodes 3"]

    @property
    def same_mesh(self) -> bool:
        """Whether the body is on the recording's own mesh."""
        return self.body.mesh is self.mesh

    @property
    def as_recorded(self) -> bool:
        """Whether the recording's own nodal forces and springs act on the body.

        They are over vertices, which is what a linear element needs. Quadratic elements take
        consistent loads on their midsides instead.
        """
        return self.same_mesh and not self.body.discretisation.element.quadratic

    @cached_property
    def _to_recording(self) -> Callable[[np.ndarray], np.ndarray]:
        if self.same_mesh:
            n = self.mesh.n_points
            return lambda u: u[:n]
        return Transfer.between(self.body.discretisation, self.mesh.points)

    def press(
        self, setup: Setup, done: Callable[[], None] = lambda: None
    ) -> list[Float[np.ndarray, "n 3"]]:
        """Solve one series, each step from the one before.

        Args:
            setup: The series as recorded.
            done: Called after each step.

        Returns:
            For each pressure the displacement of the recording's nodes, mm.

        Raises:
            ConvergenceError: The object collapses; names the press.
        """
        forces, supports = self._loads(setup), self._supports(setup)
        start: np.ndarray | None = None
        results = []
        for pressure in self.plan.pressures_mpa:
            load = float(pressure) * forces + self.weight
            try:
                found = self.body.equilibrate(self.youngs, load, supports, start=start).require()
            except ConvergenceError as error:
                place = setup.series.name
                raise ConvergenceError(f"Press {place} at {pressure:g} MPa: {error}") from error
            start = found.displacement
            results.append(self._to_recording(start))
            done()
        return results

    def _loads(self, setup: Setup) -> Float[np.ndarray, "nodes 3"]:
        if self.as_recorded:
            return setup.forces
        forces = unit_forces(self.body.discretisation, setup.series, self.plan)
        along = setup.series.push
        have, want = float((forces @ along).sum()), float((setup.forces @ along).sum())
        if abs(have - want) > _FORCE_MISMATCH * want:
            raise ConfigError(
                f"Press {setup.series.name}: 1 MPa makes {have:.4g} N on the fine mesh but"
                f" {want:.4g} N on the recording's, because the side is not flat or the meshes are"
                " not of one body; press on a flat side."
            )
        return forces * (want / have)

    def _supports(self, setup: Setup) -> Supports:
        if self.as_recorded:
            return Supports(fixed=setup.fixed, springs=setup.springs)
        total = setup.springs.sum(axis=0)
        return foundation(self.body.discretisation, setup.series, self.plan, total)

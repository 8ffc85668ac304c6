"""Solution of the presses of a plan on a soft body."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError, ConvergenceError
from tactorch.fem import SoftBody, Supports
from tactorch.mesh import TetMesh
from tactorch.simulation.boundary import BoundaryConditions, elastic_foundation, unit_forces
from tactorch.simulation.plan import PressPlan
from tactorch.simulation.transfer import Transfer

# Maximum relative difference of the total force on two meshes of a curved body; it is corrected.
_MAX_FORCE_DIFFERENCE = 0.05


@dataclass(frozen=True, eq=False)
class PressSimulator:
    """Soft body, possibly on a finer mesh than the recording's.

    Attributes:
        body: Body to press.
        youngs: Young's modulus of its elements, MPa.
        mesh: The recording's mesh.
        plan: Press plan.
        weight: Nodal forces of gravity, N.
    """

    body: SoftBody
    youngs: Float[np.ndarray, " e"]
    mesh: TetMesh
    plan: PressPlan
    weight: Float[np.ndarray, "nodes 3"]

    @property
    def same_mesh(self) -> bool:
        """Whether the body is on the recording's mesh."""
        return self.body.mesh is self.mesh

    @property
    def uses_recorded_loads(self) -> bool:
        """Whether the recording's nodal forces and springs are applied to the body.

        They are on vertices, as linear elements require; quadratic elements get consistent loads
        on midside nodes.
        """
        return self.same_mesh and not self.body.discretisation.element.quadratic

    @cached_property
    def _to_recording(self) -> Callable[[np.ndarray], np.ndarray]:
        if self.same_mesh:
            n = self.mesh.n_points
            return lambda u: u[:n]
        return Transfer.between(self.body.discretisation, self.mesh.points)

    def solve(
        self, conditions: BoundaryConditions, on_solved: Callable[[], None] = lambda: None
    ) -> list[Float[np.ndarray, "n 3"]]:
        """Solve all load steps of a site, each with a warm start from the previous one.

        Args:
            conditions: Boundary conditions of the site.
            on_solved: Called after each load step.

        Returns:
            Displacement of the recording's nodes for each load step, mm.

        Raises:
            ConvergenceError: The object collapses; the message names the press.
        """
        forces, supports = self._forces(conditions), self._supports(conditions)
        displacement: np.ndarray | None = None
        results = []
        for pressure in self.plan.pressures:
            load = pressure * forces + self.weight
            try:
                result = self.body.equilibrate(self.youngs, load, supports, start=displacement)
                displacement = result.require().displacement
            except ConvergenceError as error:
                site = conditions.site.name
                raise ConvergenceError(f"Press {site} at {pressure:g} MPa: {error}") from error
            results.append(self._to_recording(displacement))
            on_solved()
        return results

    def _forces(self, conditions: BoundaryConditions) -> Float[np.ndarray, "nodes 3"]:
        if self.uses_recorded_loads:
            return conditions.forces
        site = conditions.site
        forces = unit_forces(self.body.discretisation, site, self.plan)
        total = float((forces @ site.direction).sum())
        recorded = float((conditions.forces @ site.direction).sum())
        if abs(total - recorded) > _MAX_FORCE_DIFFERENCE * recorded:
            raise ConfigError(
                f"Press {site.name}: 1 MPa makes {total:.4g} N on the fine mesh but"
                f" {recorded:.4g} N on the recording's, because the face is not flat or the meshes"
                " are not of one body; press on a flat face."
            )
        return forces * (recorded / total)

    def _supports(self, conditions: BoundaryConditions) -> Supports:
        if self.uses_recorded_loads:
            return Supports(fixed=conditions.fixed, springs=conditions.springs)
        stiffness = conditions.springs.sum(axis=0)
        return elastic_foundation(self.body.discretisation, conditions.site, self.plan, stiffness)

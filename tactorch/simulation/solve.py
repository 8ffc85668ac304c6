"""Boundary conditions and solution of the presses of a plan on a soft body."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from tactorch.errors import ConfigError, ConvergenceError
from tactorch.fem import ELEMENTS, Discretisation, SoftBody, Supports
from tactorch.fem.boundary import pressure_forces
from tactorch.fem.transfer import Transfer
from tactorch.mesh import TetMesh, face_nodes
from tactorch.simulation.curved import curved_forces, nodes_under
from tactorch.simulation.patch import nodes_within, patch_forces
from tactorch.simulation.plan import PressPlan, PressSite, SurfaceSite

Nodal = Float[np.ndarray, "nodes 3"]
# Maximum relative difference of the total force on two meshes of a curved body; it is corrected.
_MAX_FORCE_DIFFERENCE = 0.05


class BoundaryConditions(NamedTuple):
    """Boundary conditions of one site on the n nodes of the recording's mesh."""

    site: PressSite | SurfaceSite
    forces: Float[np.ndarray, "n 3"]  # of 1 MPa, N
    observed: Bool[np.ndarray, "n 3"]  # all components of the pressed nodes
    springs: Float[np.ndarray, "n 3"]  # N/mm
    fixed: Bool[np.ndarray, "n 3"]


@dataclass(frozen=True, eq=False)
class PressSimulator:
    """Soft body, possibly on a finer mesh than the recording's."""

    body: SoftBody
    youngs: Float[np.ndarray, "e *q"]  # of each element, or quadrature point, MPa
    mesh: TetMesh  # of the recording
    plan: PressPlan
    weight: Nodal  # N

    @property
    def same_mesh(self) -> bool:
        """Whether the body is on the recording's mesh."""
        return self.body.mesh is self.mesh

    @property
    def uses_recorded_loads(self) -> bool:
        """Whether the recording's nodal forces and springs are applied to the body.

        They are on vertices, as linear elements require; quadratic elements get consistent loads
        and springs on midside nodes too.
        """
        return self.same_mesh and not self.body.discretisation.element.quadratic

    @cached_property
    def _to_recording(self) -> Callable[[np.ndarray], np.ndarray]:
        if self.same_mesh:
            n = self.mesh.n_points
            return lambda u: u[:n]
        return Transfer.between(self.body.discretisation, self.mesh.points)

    def conditions(self, site: PressSite | SurfaceSite) -> BoundaryConditions:
        """Return the boundary conditions of a site on the recording's mesh.

        Equal springs, as in the paper, are stiffer per area where nodes are dense, along edges
        above all; for two meshes to be supported alike, the total stiffness is distributed evenly
        over the area.
        """
        mesh, plan = self.mesh, self.plan
        discretisation = Discretisation(mesh, ELEMENTS["tet4"])
        nodes = _pressed_nodes(mesh, site, plan)
        observed = np.zeros((mesh.n_points, 3), dtype=bool)
        observed[nodes] = True
        springs = np.zeros((mesh.n_points, 3))
        if plan.support == "springs":
            springs[face_nodes(mesh, site.opposite)] = plan.spring_n_per_mm
            if not self.uses_recorded_loads:
                springs = _distribute(springs.sum(axis=0), discretisation, site)
        forces = _unit_forces(discretisation, site, plan)
        return BoundaryConditions(site, forces, observed, springs, _fixed_dofs(mesh, site, plan))

    def solve(
        self, conditions: BoundaryConditions, on_solved: Callable[[], None] = lambda: None
    ) -> list[Float[np.ndarray, "n 3"]]:
        """Return the displacement (mm) of the recording's nodes for each load step of a site.

        Each load step starts from the previous one; `on_solved` is called after each.
        """
        forces, supports = self._loads(conditions)
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

    def _loads(self, conditions: BoundaryConditions) -> tuple[Nodal, Supports]:
        """Nodal forces of 1 MPa (N) on the body, of the recording's total, and its supports."""
        site, _, _, springs, fixed = conditions
        if self.uses_recorded_loads:
            return conditions.forces, Supports(fixed=fixed, springs=springs)
        discretisation = self.body.discretisation
        forces = _unit_forces(discretisation, site, self.plan)
        total = float((forces @ site.direction).sum())
        recorded = float((conditions.forces @ site.direction).sum())
        if abs(total - recorded) > _MAX_FORCE_DIFFERENCE * recorded:
            raise ConfigError(
                f"Press {site.name}: 1 MPa makes {total:.4g} N on the fine mesh but"
                f" {recorded:.4g} N on the recording's, because the face is not flat or the meshes"
                " are not of one body; press on a flat face."
            )
        fixed = _fixed_dofs(discretisation.mesh, site, self.plan)
        springs = _distribute(springs.sum(axis=0), discretisation, site)
        return forces * (recorded / total), Supports(fixed=fixed, springs=springs)


def _pressed_nodes(
    mesh: TetMesh, site: PressSite | SurfaceSite, plan: PressPlan
) -> Int[np.ndarray, " k"]:
    if isinstance(site, SurfaceSite):
        return nodes_under(mesh, site, plan.patch_radius_mm or 0.0)
    nodes = face_nodes(mesh, site.face)
    if plan.patch_radius_mm is None:
        return nodes
    return nodes_within(mesh, nodes, site, plan.patch_radius_mm)


def _unit_forces(
    discretisation: Discretisation, site: PressSite | SurfaceSite, plan: PressPlan
) -> Nodal:
    """Consistent nodal forces of 1 MPa on the face or its patch, N."""
    if isinstance(site, SurfaceSite):
        return curved_forces(discretisation, site, plan.patch_radius_mm or 0.0)
    if plan.patch_radius_mm is not None:
        return patch_forces(discretisation, site, plan.patch_radius_mm)
    return pressure_forces(discretisation, site.face, 1.0).numpy()


def _distribute(
    stiffness: Float[np.ndarray, "3"], discretisation: Discretisation, site: PressSite | SurfaceSite
) -> Nodal:
    """Distribute a total stiffness (N/mm along each axis) evenly over the supported face.

    Consistent with the element: under a uniform reaction only the midside nodes of quadratic
    elements carry load.
    """
    forces = pressure_forces(discretisation, site.opposite, 1.0).numpy()
    areas = np.abs(forces[:, site.axis])
    return (areas / areas.sum())[:, None] * stiffness


def _fixed_dofs(
    mesh: TetMesh, site: PressSite | SurfaceSite, plan: PressPlan
) -> Bool[np.ndarray, "n 3"]:
    """Degrees of freedom with zero displacement; none with springs.

    A roller fixes two more nodes tangentially against rigid motion.
    """
    fixed = np.zeros((mesh.n_points, 3), dtype=bool)
    nodes = face_nodes(mesh, site.opposite)
    if plan.support == "fixed":
        fixed[nodes] = True
    if plan.support == "roller":
        fixed[nodes, site.axis] = True
        positions = mesh.points[nodes][:, site.tangential]
        anchor = int(np.lexsort(np.round(positions, 9).T[::-1])[0])
        fixed[nodes[anchor], site.tangential] = True
        # Fixing the node best aligned with the first axis, far from the anchor, across that axis
        # prevents rotation without restraining a uniform expansion.
        along, across = np.abs(positions - positions[anchor]).T
        other = int(np.argmin(np.where(along >= 0.5 * along.max(), across, np.inf)))
        fixed[nodes[other], site.tangential[1]] = True
    return fixed

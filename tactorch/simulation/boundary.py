"""Boundary conditions of presses: loads on the pressed face, supports of the opposite face."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from tactorch.fem import ELEMENTS, Discretisation, Supports
from tactorch.fem.loads import pressure_forces
from tactorch.fem.supports import CaseSupports
from tactorch.mesh import TetMesh, face_nodes
from tactorch.simulation.patch import nodes_within, patch_forces
from tactorch.simulation.plan import PressPlan, PressSite


@dataclass(frozen=True, eq=False)
class BoundaryConditions:
    """Boundary conditions of one site on the n nodes of the recording's mesh.

    Attributes:
        site: Location of the presses.
        forces: Nodal forces of a pressure of 1 MPa, N.
        observed: Observed degrees of freedom: all components of the pressed nodes.
        springs: Stiffness of the springs, N/mm.
        fixed: Degrees of freedom with zero displacement.
    """

    site: PressSite
    forces: Float[np.ndarray, "n 3"]
    observed: Bool[np.ndarray, "n 3"]
    springs: Float[np.ndarray, "n 3"]
    fixed: Bool[np.ndarray, "n 3"]

    @classmethod
    def on(
        cls, mesh: TetMesh, site: PressSite, plan: PressPlan, *, even_springs: bool
    ) -> "BoundaryConditions":
        """Build the boundary conditions of a site.

        Args:
            mesh: The recording's mesh.
            site: Location of the presses.
            plan: Press plan.
            even_springs: Whether the total stiffness is distributed evenly over the area rather
                than equally over the nodes.

        Raises:
            ConfigError: The patch misses the object or contains no node.
            MeshError: The object has no such flat face.
        """
        nodes = face_nodes(mesh, site.face)
        if plan.patch_radius_mm is not None:
            nodes = nodes_within(mesh, nodes, site, plan.patch_radius_mm)
        observed = np.zeros((mesh.n_points, 3), dtype=bool)
        observed[nodes] = True
        return cls(
            site,
            unit_forces(Discretisation(mesh, ELEMENTS["tet4"]), site, plan),
            observed,
            _spring_stiffness(mesh, site, plan, even_springs),
            fixed_dofs(mesh, site, plan),
        )


def unit_forces(
    discretisation: Discretisation, site: PressSite, plan: PressPlan
) -> Float[np.ndarray, "nodes 3"]:
    """Return the consistent nodal forces of 1 MPa on the face or its patch, N."""
    if plan.patch_radius_mm is not None:
        return patch_forces(discretisation, site, plan.patch_radius_mm)
    return pressure_forces(discretisation, site.face, 1.0).numpy()


def _spring_stiffness(
    mesh: TetMesh, site: PressSite, plan: PressPlan, even: bool
) -> Float[np.ndarray, "n 3"]:
    """Return the stiffness of the springs on each node, N/mm.

    Equal springs, as in the paper, are stiffer per area where nodes are dense, along edges above
    all; for two meshes to be supported alike, the total is distributed evenly over the area.
    """
    springs = np.zeros((mesh.n_points, 3))
    if plan.support == "springs":
        springs[face_nodes(mesh, site.opposite)] = plan.spring_n_per_mm
        if even:
            fractions = _area_fractions(Discretisation(mesh, ELEMENTS["tet4"]), site)
            springs = fractions[:, None] * springs.sum(axis=0)
    return springs


def _area_fractions(discretisation: Discretisation, site: PressSite) -> Float[np.ndarray, " nodes"]:
    """Return each node's fraction of the area of the supported face."""
    forces = pressure_forces(discretisation, site.opposite, 1.0).numpy()
    areas = np.abs(forces @ site.direction)
    return areas / areas.sum()


@dataclass(frozen=True, eq=False)
class ElasticFoundation(Supports):
    """Supports with springs on all nodes of an element mesh, midside nodes included.

    On quadratic elements, springs on vertices alone are inconsistent: under a uniform reaction
    only midside nodes carry load.

    Attributes:
        node_springs: Stiffness of the springs on vertices, then midside nodes, N/mm.
    """

    node_springs: Float[np.ndarray, "nodes 3"] | None = None

    def case(self, index: int, discretisation: Discretisation) -> CaseSupports:
        """Return the load case; see `Supports.case`."""
        case = super().case(index, discretisation)
        return case if self.node_springs is None else replace(case, springs=self.node_springs)


def elastic_foundation(
    discretisation: Discretisation,
    site: PressSite,
    plan: PressPlan,
    stiffness: Float[np.ndarray, "3"],
) -> ElasticFoundation:
    """Support the face opposite to a press on another mesh than the recording's.

    The total stiffness (N/mm along each axis) is distributed over the face consistently with the
    element, because equal springs per node would make a finer mesh stiffer.
    """
    springs = _area_fractions(discretisation, site)[:, None] * stiffness
    return ElasticFoundation(
        fixed=fixed_dofs(discretisation.mesh, site, plan), node_springs=springs
    )


def fixed_dofs(mesh: TetMesh, site: PressSite, plan: PressPlan) -> Bool[np.ndarray, "n 3"]:
    """Return the degrees of freedom with zero displacement; none with springs.

    A roller fixes two more nodes tangentially against rigid motion.
    """
    fixed = np.zeros((mesh.n_points, 3), dtype=bool)
    nodes = face_nodes(mesh, site.opposite)
    if plan.support == "fixed":
        fixed[nodes] = True
    if plan.support == "roller":
        fixed[nodes, site.axis] = True
        first, second = (i for i in range(3) if i != site.axis)
        tangential = mesh.points[nodes][:, [first, second]]
        anchor = int(np.lexsort(np.round(tangential, 9).T[::-1])[0])
        fixed[nodes[anchor], [first, second]] = True
        fixed[nodes[_farthest_along(tangential - tangential[anchor])], second] = True
    return fixed


def _farthest_along(offsets: Float[np.ndarray, "k 2"]) -> int:
    """The node best aligned with the first axis, far from the anchor.

    Fixing it across that axis prevents rotation without restraining a uniform expansion.
    """
    far = np.abs(offsets[:, 0]) >= 0.5 * np.abs(offsets[:, 0]).max()
    return int(np.argmin(np.where(far, np.abs(offsets[:, 1]), np.inf)))

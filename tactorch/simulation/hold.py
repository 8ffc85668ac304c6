"""What holds the object on the side opposite to a press."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from tactorch.fem import ELEMENTS, Discretisation, Supports
from tactorch.fem.loads import pressure_forces
from tactorch.fem.supports import CaseSupports
from tactorch.mesh import TetMesh, face_nodes
from tactorch.simulation.plan import PressPlan, Series


def spring_stiffness(
    mesh: TetMesh, series: Series, plan: PressPlan, *, even: bool
) -> Float[np.ndarray, "n 3"]:
    """Return the stiffness of the springs on each node, N/mm; zero where the plan has none.

    Springs of one stiffness, as in the paper, hold a side more firmly where its nodes are dense,
    along its edges above all. Where two meshes are to hold it alike, the same total is spread
    evenly over its area.
    """
    springs = np.zeros((mesh.n_points, 3))
    if plan.hold == "springs":
        springs[face_nodes(mesh, series.opposite)] = float(plan.spring_n_per_mm)
        if even:
            shares = area_shares(Discretisation(mesh, ELEMENTS["tet4"]), series)
            springs = shares[:, None] * springs.sum(axis=0)
    return springs


def area_shares(discretisation: Discretisation, series: Series) -> Float[np.ndarray, " nodes"]:
    """Return each node's share of the area of the side opposite to a press; they add up to one."""
    areas = np.abs(pressure_forces(discretisation, series.opposite, 1.0).numpy() @ series.push)
    return areas / areas.sum()


@dataclass(frozen=True, eq=False)
class Foundation(Supports):
    """Supports with springs on all nodes of an element mesh, midsides included.

    Springs on the vertices of quadratic elements alone would be a bed of nails: under a uniform
    reaction only midsides carry.

    Attributes:
        node_springs: Stiffness of the springs on vertices, then midsides, N/mm.
    """

    node_springs: Float[np.ndarray, "nodes 3"] | None = None

    def case(self, index: int, discretisation: Discretisation) -> CaseSupports:
        """Return the one load case; see `Supports.case`."""
        held = super().case(index, discretisation)
        return held if self.node_springs is None else replace(held, springs=self.node_springs)


def foundation(
    discretisation: Discretisation, series: Series, plan: PressPlan, total: Float[np.ndarray, "3"]
) -> Foundation:
    """Hold the side opposite to a press on another mesh than the recording's.

    One spring per node would hold a finer mesh more stiffly. Here the total stiffness (N/mm per
    axis) is spread evenly over the side, consistently with the element: an elastic foundation.
    """
    springs = area_shares(discretisation, series)[:, None] * total
    return Foundation(fixed=fixed_freedoms(discretisation.mesh, series, plan), node_springs=springs)


def fixed_freedoms(mesh: TetMesh, series: Series, plan: PressPlan) -> Bool[np.ndarray, "n 3"]:
    """Return the degrees of freedom held exactly at zero; none where the plan has springs."""
    fixed = np.zeros((mesh.n_points, 3), dtype=bool)
    nodes = face_nodes(mesh, series.opposite)
    if plan.hold == "fixed":
        fixed[nodes] = True
    if plan.hold == "roller":
        fixed[nodes, series.axis] = True
        first, second = (i for i in range(3) if i != series.axis)
        across = mesh.points[nodes][:, [first, second]]
        anchor = int(np.lexsort(np.round(across, 9).T[::-1])[0])
        fixed[nodes[anchor], [first, second]] = True
        fixed[nodes[_along(across - across[anchor])], second] = True
    return fixed


def _along(offsets: Float[np.ndarray, "k 2"]) -> int:
    """The node most exactly along the first axis, far from the anchor.

    Holding it across that axis stops a turn without hindering a uniform spread.
    """
    far = np.abs(offsets[:, 0]) >= 0.5 * np.abs(offsets[:, 0]).max()
    return int(np.argmin(np.where(far, np.abs(offsets[:, 1]), np.inf)))

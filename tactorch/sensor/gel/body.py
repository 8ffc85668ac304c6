"""Finite elements of a gel: equilibria, and their changes by prescribed displacements."""

import numpy as np
from jaxtyping import Bool, Float

from tactorch.fem import NewtonOptions, SoftBody, Supports, make_material
from tactorch.fem.equilibrium import SolvedCase
from tactorch.mesh import TetMesh
from tactorch.sensor.description import GelLayer

_NEWTON_RTOL = 1e-8

NodeVectors = Float[np.ndarray, "nodes 3"]
VertexVectors = Float[np.ndarray, "n 3"]


class GelBody:
    """Gel on a mesh.

    Attributes:
        body: Finite element model.
        youngs: Young's modulus of each element, MPa.
    """

    def __init__(self, mesh: TetMesh, gel: GelLayer, element: str) -> None:
        law, newton = make_material(gel.material, gel.poisson), NewtonOptions(rtol=_NEWTON_RTOL)
        self.body = SoftBody(mesh, law, element=element, newton=newton)
        self.youngs = np.full(mesh.n_tets, gel.youngs_mpa)

    def equilibrium(
        self,
        prescribed: VertexVectors,
        load: NodeVectors | None = None,
        start: NodeVectors | None = None,
        previous: SolvedCase | None = None,
    ) -> SolvedCase:
        """Return the equilibrium with prescribed displacements (mm), NaN where free, and loads (N).

        The factorization of a previous state is reused.
        """
        fixed = np.isfinite(prescribed)
        supports = Supports(fixed=fixed, prescribed=np.where(fixed, prescribed, 0.0))
        forces = np.zeros(prescribed.shape) if load is None else load
        after = None if previous is None else previous.newton
        newton = self.body.search(self.youngs, forces, supports, after=after)
        return SolvedCase(newton, newton.run(start).require())

    def internal_forces(self, state: SolvedCase) -> NodeVectors:
        """Return the elastic forces on all element nodes at an equilibrium, N."""
        response = state.result.response
        assert response is not None
        return self.body.assembly.internal_force(response, self.youngs)

    def fields(
        self, state: SolvedCase, prescribed: Float[np.ndarray, "k n 3"]
    ) -> Float[np.ndarray, "unknowns k"]:
        """Return changes of an equilibrium by changes of its prescribed displacements, mm."""
        extended = (self.body.discretisation.extend(one).ravel() for one in prescribed)
        linear = state.linearization
        moved = np.stack([np.where(linear.fixed, one, 0.0) for one in extended], axis=1)
        loads = state.newton.tangent_times(state.result, moved)
        return moved - np.asarray(linear.solve(np.asfortranarray(loads)))

    def at_vertices(
        self, forces: NodeVectors, selected: Bool[np.ndarray, " n"]
    ) -> Float[np.ndarray, "n 3"]:
        """Return forces on the vertices of the mesh from those on all element nodes.

        Forces on midside nodes are divided between both ends, where both are selected.
        """
        n, edges = self.body.mesh.n_points, self.body.discretisation.edges
        gathered = forces[:n].copy()
        if len(forces) > n:
            within = selected[edges].all(axis=1)
            for end in (0, 1):
                np.add.at(gathered, edges[within, end], 0.5 * forces[n:][within])
        return gathered


def rms(values: np.ndarray) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(values**2)))

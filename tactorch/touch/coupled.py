"""One or two gels and a body in front of them, as one assembly whose parts touch."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from tactorch.config import to_mapping
from tactorch.errors import ConfigError, ConvergenceError
from tactorch.fem import NewtonOptions, Supports, make_material
from tactorch.fem.assembly import Assembly
from tactorch.fem.boundary import CaseSupports
from tactorch.fem.contact.contact import RELATIVE_STIFFNESS
from tactorch.fem.contact.pair import PairContact
from tactorch.fem.newton import EquilibriumResult, Newton
from tactorch.linalg import SolverPool
from tactorch.mesh import TetMesh
from tactorch.recording import MaterialSpec
from tactorch.sensor.gel import GelMesh
from tactorch.touch.pairing import Facing

_REACH = 2.0  # distance of pairs that may touch, over the depth
_FIRST_RTOL = 1e-3  # of the forces without friction
# Pairs of a first guess: those whose gap is less than this share of the depth. Contacts extend to
# gaps of half the depth (Hertz), and of all of it under a thin gel.
_TOUCHED, _GUESS_RTOL = 0.6, 0.02
# Springs that keep a body between gels upright, over its modulus times its size, and their part.
_MIDDLE, _MIDDLE_WIDTH = 3.0, 0.03
_STRIDE = 0.5  # of a first guess, over the thickness of the gel


@dataclass(frozen=True, eq=False)
class CoupledState:
    """An equilibrium of gel and body.

    Attributes:
        contact: Their contact, which has the motion of the gel.
        newton: The equilibrium search.
        result: Its result, in the frame of the sensor.
    """

    contact: PairContact
    newton: Newton
    result: EquilibriumResult

    @property
    def displacement(self) -> Float[np.ndarray, "nodes 3"]:
        """Displacement of all nodes, mm; that of the gel's relative to its window."""
        return self.result.displacement

    def motion_forces(self) -> Float[np.ndarray, "3 nodes 3"]:
        """Return the changes of the forces on all nodes by motions of the gel against the body.

        They are by a translation along the axis (N/mm) and by tilts about x and y through the
        origin (N/rad), which change how far pairs penetrate. Pairs remain in contact. That the
        press turns with a tilt is left out, so that tilts change markers by less: by 0.73 of it at
        a depth of 0.4 mm, and by 0.47 at 0.8 mm, under a gel of 4 mm on a cube of 10 mm.
        """
        contact, pairs = self.contact, self.contact.pairs
        springs = contact.springs(self.displacement)
        at_pairs = np.zeros((3, *pairs.points.shape))
        at_pairs[..., 2] = springs[:, 2] * along_axis(pairs.points)
        return np.stack([pairs.spread(one) for one in at_pairs])


class Coupled:
    """A gel and a body at a place, prepared for several motions.

    All fields are in the frame of the sensor. Nodes are the points of the body, those of the gel,
    and the midside nodes of both.

    Args:
        facing: Points of gels and body that are opposite to each other.
        body: Mesh of the body.
        gel: Mesh of the gel.
        material: Constitutive law of the body; that of the gel has another Poisson's ratio.
        supports: Fixed points of the body, and springs, the same along all axes.
        body_mpa: Typical Young's modulus of the body, for the stiffness of the contact, MPa.
        depth_mm: Largest motion of the gel.
        sticks: Whether points that a first solution without friction has in contact do not slip.
        rtol: Residual of equilibria.

    Attributes:
        parts: Discretisation of both.
        counts: Number of elements of body and gel.
        n_body: Number of points of the body, which are the first ones.
        body_rows: Nodes of the body, in the order of a discretisation of the body alone.
        face_rows: Nodes of the gel's face, midside nodes last.
        body_points: Points of the body of each pair at rest, in its own frame, mm.
        opposed: Pairs of the opposed gel.
    """

    def __init__(
        self,
        facing: Facing,
        body: TetMesh,
        gel: GelMesh,
        material: MaterialSpec,
        supports: Supports,
        *,
        body_mpa: float,
        depth_mm: float,
        sticks: bool = True,
        rtol: float = 1e-7,
    ) -> None:
        layer = gel.layer
        pairs, near = facing.pairs(_REACH * depth_mm)
        self.parts, self._sticks, self._rtol = pairs.discretisation, sticks, rtol
        softest = min(float(layer.youngs_mpa), body_mpa)
        stiffness = RELATIVE_STIFFNESS * softest / float(np.sqrt(np.median(gel.mesh.surface.areas)))
        none = np.zeros(int(near.sum()), dtype=bool)
        self.contact = PairContact(pairs, np.zeros(3), stiffness, none)
        gels = (facing.mesh.n_points - body.n_points) // gel.mesh.n_points
        self.counts, self.n_body = (body.n_tets, gels * gel.mesh.n_tets), body.n_points
        poisson = np.repeat([material.poisson, float(layer.poisson)], self.counts)
        law = make_material(layer.material, layer.poisson)
        self.assembly = Assembly(self.parts, law, poisson, self.parts.mesh.points)
        self.forget()
        self.gel_mpa = float(layer.youngs_mpa)
        self._stride_mm = _STRIDE * float(layer.thickness_mm)
        fixed = np.zeros(body.points.shape, bool) if supports.fixed is None else supports.fixed
        window = np.repeat(np.tile(gel.on_window, gels)[:, None], 3, axis=1)
        springs = None
        if supports.springs is not None:
            springs = np.concatenate([supports.springs, np.zeros((len(window), 3))])
        held = Supports(fixed=np.concatenate([fixed, window]), springs=springs)
        self.supports = held.case(0, self.parts)
        self._upright = self._with_springs(body, body_mpa) if gels > 1 else self.supports
        vertices = np.arange(self.parts.mesh.n_points) >= body.n_points
        on_gel = np.concatenate([vertices, vertices[self.parts.edges[:, 0]]])
        self.body_rows: Int[np.ndarray, " b"] = np.flatnonzero(~on_gel)
        face = gel.face[gel.face_triangles] + body.n_points
        self.face_rows: Int[np.ndarray, " g"] = np.unique(self.parts.surface_nodes(face))
        self.opposed: Bool[np.ndarray, " p"] = facing.opposed[near]
        corners = body.points[body.surface.triangles[facing.faces[near]]]
        self.body_points = np.einsum("pc,pcd->pd", facing.barycentric[near], corners)

    def _with_springs(self, body: TetMesh, body_mpa: float) -> CaseSupports:
        """Return supports that keep a body from turning between gels without friction.

        They are along z and in the middle, which hardly moves along z, and for a first solution.
        """
        z = self.parts.mesh.points[: body.n_points, 2]
        off, size = np.abs(z - 0.5 * (z.min() + z.max())), float(np.ptp(z))
        middle = np.flatnonzero(off <= max(_MIDDLE_WIDTH * size, float(np.partition(off, 3)[3])))
        springs = self.supports.springs.copy()
        springs[middle, 2] += _MIDDLE * body_mpa * size / len(middle)
        return self.supports._replace(springs=springs)

    def forget(self) -> None:
        """Free the factorisations of earlier solutions, which take gigabytes on fine meshes."""
        self.pool = SolverPool(self.parts.pattern)

    def youngs(self, body: Float[np.ndarray, "m *q"]) -> Float[np.ndarray, "m2 q"]:
        """Return the moduli of all elements' quadrature points from those of the body, MPa."""
        points = self.assembly.weights.shape[1]
        own = np.broadcast_to(body.reshape(len(body), -1), (len(body), points))
        return np.concatenate([own, np.full((self.counts[1], points), self.gel_mpa)])

    def body_changes(
        self, changes: Float[np.ndarray, "k moduli"]
    ) -> Float[np.ndarray, "k all_moduli"]:
        """Return changes of all moduli by those at the quadrature points of the body."""
        return np.pad(changes, ((0, 0), (0, self.assembly.weights.size - changes.shape[1])))

    @cached_property
    def gel_change(self) -> Float[np.ndarray, " all_moduli"]:
        """Change of all moduli by the logarithm of the gel's, MPa."""
        change = np.zeros(self.assembly.weights.shape)
        change[self.counts[0] :] = self.gel_mpa
        return change.ravel()

    def solve(
        self,
        youngs: Float[np.ndarray, "m2 q"],
        motion_mm: Float[np.ndarray, "3"],
        start: Float[np.ndarray, "nodes 3"] | None = None,
        sticking: Bool[np.ndarray, " p"] | None = None,
    ) -> CoupledState:
        """Return the equilibrium of moduli (MPa) and a motion from the pose in which both face.

        It is searched from displacements of all nodes, `start`, mm. `sticking` are the pairs that
        do not slip, where they are known already.

        Raises:
            ConvergenceError: There is none.
        """
        contact = replace(self.contact, motion_mm=motion_mm)
        if sticking is not None:
            contact = replace(contact, sticking=sticking)
        is_last = sticking is not None or not self._sticks
        rtol = self._rtol if is_last else _FIRST_RTOL
        if sticking is None:
            newton, start = self._guess(contact, youngs, start)
            newton = self._search(contact, youngs, rtol, newton, self._upright)
        else:
            newton = self._search(contact, youngs, rtol)
        result = newton.run(start)
        if not is_last and result.converged:
            sticking = contact.offsets(result.displacement)[:, 2] < 0.0
            contact = replace(contact, sticking=sticking)
            newton = self._search(contact, youngs, self._rtol, newton)
            result = newton.run(result.displacement)
        if not result.converged:
            raise ConvergenceError(
                f"no equilibrium of gel and body at {motion_mm[2]:.3g} mm from first touch:"
                f" {result.reason} Give a smaller depth_mm, or a larger gel_edge_mm."
            )
        return CoupledState(contact, newton, result)

    def _guess(
        self,
        contact: PairContact,
        youngs: Float[np.ndarray, "m2 q"],
        start: Float[np.ndarray, "nodes 3"] | None,
    ) -> tuple[Newton | None, Float[np.ndarray, "nodes 3"] | None]:
        """Return a search and displacements near the equilibrium, in which fewer pairs touch.

        From a contact that is too large, each iteration releases a ring of pairs only. Deep presses
        are approached in steps. They are None and `start` where the contact is flat.
        """
        pairs, depth, newton = contact.pairs, float(contact.motion_mm[2]), None
        steps = int(np.ceil(depth / self._stride_mm)) if start is None else 1
        for step in range(1, steps + 1):
            moved = contact.moved(step / steps)
            reached = float(moved.motion_mm[2])
            far = pairs.gaps_mm > _TOUCHED * reached
            if reached <= 0.0 or not (far.any() or steps > 1):
                return None, start
            gaps = np.where(far, pairs.gaps_mm + _REACH * depth, pairs.gaps_mm)
            moved = replace(moved, pairs=replace(pairs, gaps_mm=gaps))
            newton = self._search(moved, youngs, _GUESS_RTOL, newton, self._upright)
            start = newton.run(start).displacement
        return newton, start

    def _search(
        self,
        contact: PairContact,
        youngs: Float[np.ndarray, "m2 q"],
        rtol: float,
        after: Newton | None = None,
        supports: CaseSupports | None = None,
    ) -> Newton:
        options, nothing = NewtonOptions(rtol=rtol), np.zeros((self.parts.n_nodes, 3))
        return Newton(
            self.assembly, self.pool, youngs, nothing, supports or self.supports, options, after,
            contact=contact,
        )  # fmt: skip


def along_axis(points: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, "3 p"]:
    """Return the motions along z of points (mm) by a translation and by tilts about x and y."""
    return np.stack([np.ones(len(points)), points[:, 1], -points[:, 0]])


def check_material(material: MaterialSpec, law: str) -> None:
    """Raise ConfigError unless a body is of the constitutive law of a gel."""
    body = make_material(material.name, material.poisson, **material.parameters)
    gel = make_material(law, material.poisson)
    if type(body) is not type(gel) or to_mapping(body) != to_mapping(gel):
        raise ConfigError(
            f"material={material.name} {material.parameters or ''} differs from {law} of the gel;"
            f" both are solved together, so give material={law} with its default parameters."
        )

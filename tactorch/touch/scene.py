"""A gel pressed on a soft body: one equilibrium of both, with opposite and equal forces.

Both are hyperelastic, of quadratic elements. They touch along the axis of the sensor; points of the
gel are paired with the points of the body that are opposite to them at rest
(`tactorch.fem.contact.pair`). The window of the gel and the base of the body are rigid.

With friction, points that a first solution without friction has in contact do not slip relative to
each other from rest on: there is no limit of friction, and no order in which they came into
contact. The surface is that of the body's shape, not of its mesh; sharp edges are as sharp as the
gel's elements.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from tactorch.config import to_mapping
from tactorch.errors import ConfigError, ConvergenceError
from tactorch.fem import ELEMENTS, NewtonOptions, Supports, make_material
from tactorch.fem.assembly import Assembly
from tactorch.fem.contact.contact import RELATIVE_STIFFNESS
from tactorch.fem.contact.pair import PairContact
from tactorch.fem.newton import EquilibriumResult, Newton
from tactorch.linalg import SolverPool
from tactorch.mesh import TetMesh
from tactorch.phantoms import Phantom
from tactorch.recording import MaterialSpec
from tactorch.sensor.description import SensorDescription
from tactorch.sensor.gel import GelMesh
from tactorch.sensor.poses import Pose, rotate_vectors
from tactorch.touch.options import TouchOptions
from tactorch.touch.pairing import ELEMENT, Facing, face_each_other

_REACH = 2.0  # distance of pairs that may touch, over the depth
_FIRST_RTOL, _RTOL = 1e-3, 1e-7  # of the forces without friction, and at the end


@dataclass(frozen=True, eq=False)
class GelPress:
    """A gel and a body in equilibrium.

    Attributes:
        pose: T_object_sensor.
        first_pose: T_object_sensor at first touch.
        gel_points: Nodes of the gel's face at rest, midside nodes last, (g, 3), mm, sensor frame.
        gel_displacement: Their displacement, (g, 3), mm, sensor frame.
        gel_forces: Forces on them, (g, 3), N, sensor frame: loads of quadratic elements, of which
            midside nodes have most.
        points: Points of the body in contact at rest, (q, 3), mm.
        forces: Forces of the gel on the body at these, (q, 3), N.
        displacement: Displacement of all nodes of the body, (nodes, 3), mm.
        base_force: Force of the support on the body, (3,), N.
    """

    pose: Pose
    first_pose: Pose
    gel_points: Float[np.ndarray, "g 3"]
    gel_displacement: Float[np.ndarray, "g 3"]
    gel_forces: Float[np.ndarray, "g 3"]
    points: Float[np.ndarray, "q 3"]
    forces: Float[np.ndarray, "q 3"]
    displacement: Float[np.ndarray, "nodes 3"]
    base_force: Float[np.ndarray, "3"]


@dataclass(frozen=True, eq=False)
class TouchScene:
    """A sensor and a body.

    Attributes:
        phantom: The body.
        mesh: Its mesh, mm.
        material: Its constitutive law, that of the gel, with another Poisson's ratio.
        sensor: The sensor.
        options: Meshing of the gel, friction and support.

    Raises:
        ConfigError: Gel and body are of different laws.
    """

    phantom: Phantom
    mesh: TetMesh
    material: MaterialSpec
    sensor: SensorDescription
    options: TouchOptions

    def __post_init__(self) -> None:
        check_material(self.material, self.sensor)

    @cached_property
    def gel(self) -> GelMesh:
        """The gel."""
        return self.options.gel_mesh(self.sensor.gel)

    @cached_property
    def youngs(self) -> Float[np.ndarray, "m q"]:
        """Young's modulus of the body at the quadrature points of each element, MPa."""
        at = ELEMENTS[ELEMENT].points @ self.mesh.points[self.mesh.tets]
        return self.phantom.youngs_at(at.reshape(-1, 3)).reshape(at.shape[:2])

    @property
    def held(self) -> Bool[np.ndarray, " n"]:
        """Nodes of the body that are held."""
        return held_nodes(self.mesh, self.options.held_side, self.options.held)

    def facing(self, pose: Pose) -> Facing | None:
        """Return gel and body in a pose (T_object_sensor); None where they cannot touch."""
        return face_each_other(self.mesh, self.phantom.body, self.gel, pose)

    def press(
        self, pose: Pose, motions_mm: Sequence[Float[np.ndarray, "3"]], facing: Facing | None = None
    ) -> list[GelPress]:
        """Move the sensor from first touch, and return the equilibrium of each motion.

        Args:
            pose: T_object_sensor; the sensor is moved along its axis until it touches.
            motions_mm: Motions from first touch in the sensor frame, whose z is the depth.
            facing: Result of `facing` in this pose, if known.

        Raises:
            ConfigError: The gel is over no part of the body in this pose.
            ConvergenceError: There is no equilibrium at this depth.
        """
        facing = facing or self.facing(pose)
        if facing is None:
            raise ConfigError("the gel is over no part of the body; check the pose of the sensor.")
        first_pose = pose.copy()
        first_pose[:3, 3] += facing.first_touch[1] * pose[:3, 2]
        coupled = _Coupled(self, facing, max(float(motion[2]) for motion in motions_mm))
        presses, u = [], None
        for motion in motions_mm:
            contact, result = coupled.solve(np.asarray(motion, dtype=float), u)
            u = result.displacement
            presses.append(coupled.press(contact, result, first_pose))
        return presses


def check_material(material: MaterialSpec, sensor: SensorDescription) -> None:
    """Raise ConfigError unless a body and the gel of a sensor are of one constitutive law."""
    gel = sensor.gel
    body = make_material(material.name, material.poisson, **material.parameters)
    other = make_material(gel.material, material.poisson)
    if type(body) is not type(other) or to_mapping(body) != to_mapping(other):
        raise ConfigError(
            f"material={material.name} {material.parameters or ''} differs from {gel.material} of"
            f" the gel of the sensor '{sensor.name}'; both are solved together, so give"
            f" material={gel.material} with its default parameters."
        )


def held_nodes(mesh: TetMesh, side: str, fraction: float) -> Bool[np.ndarray, " n"]:
    """Return the nodes within a fraction of the extent of a mesh from a side of its box."""
    axis = "xyz".index(side[0])
    low, high = mesh.bounds[:, axis]
    away = mesh.points[:, axis] - low if side[1] == "-" else high - mesh.points[:, axis]
    return np.asarray(away <= fraction * (high - low) + 1e-9 * mesh.diagonal)


class _Coupled:
    """Both bodies at a place, prepared for several motions."""

    def __init__(self, scene: TouchScene, facing: Facing, depth_mm: float) -> None:
        body, gel, layer = scene.mesh, scene.gel.mesh, scene.sensor.gel
        pairs, near = facing.pairs(_REACH * depth_mm)
        self.friction, self.parts = scene.options.friction, pairs.discretisation
        softest = min(float(layer.youngs_mpa), float(np.median(scene.youngs)))
        stiffness = RELATIVE_STIFFNESS * softest / float(np.sqrt(np.median(gel.surface.areas)))
        none = np.zeros(int(near.sum()), dtype=bool)
        self.contact = PairContact(pairs, np.zeros(3), stiffness, none)
        poisson = np.repeat(
            [scene.material.poisson, float(layer.poisson)], [body.n_tets, gel.n_tets]
        )
        law = make_material(layer.material, layer.poisson)
        self.assembly = Assembly(self.parts, law, poisson, self.parts.mesh.points)
        self.pool = SolverPool(self.parts.pattern)
        stiff = np.full((gel.n_tets, scene.youngs.shape[1]), float(layer.youngs_mpa))
        self.youngs = np.concatenate([scene.youngs, stiff])
        fixed = np.repeat(np.concatenate([scene.held, scene.gel.on_window])[:, None], 3, axis=1)
        self.supports = Supports(fixed=fixed).case(0, self.parts)
        vertices = np.arange(self.parts.mesh.n_points) >= body.n_points
        on_gel = np.concatenate([vertices, vertices[self.parts.edges[:, 0]]])
        # Nodes of the body, in the order of those of a discretisation of the body alone.
        self.body_rows = np.flatnonzero(~on_gel)
        # Nodes of the gel's face, midside nodes last.
        face = scene.gel.face[scene.gel.face_triangles] + body.n_points
        self.gel_rows = np.unique(self.parts.surface_nodes(face))
        # Points of the body of each pair at rest, mm.
        corners = body.points[body.surface.triangles[facing.faces[near]]]
        self.body_points = np.einsum("pc,pcd->pd", facing.barycentric[near], corners)

    def solve(
        self, motion_mm: Float[np.ndarray, "3"], start: Float[np.ndarray, "nodes 3"] | None
    ) -> tuple[PairContact, EquilibriumResult]:
        """Return the contact and the equilibrium of a motion.

        Raises:
            ConvergenceError: There is none.
        """
        contact = replace(self.contact, motion_mm=motion_mm)
        sticks = self.friction == "stick"
        search = self._search(contact, _FIRST_RTOL if sticks else _RTOL)
        result = search.run(start)
        if sticks and result.converged:
            sticking = contact.offsets(result.displacement)[:, 2] < 0.0
            contact = replace(contact, sticking=sticking)
            result = self._search(contact, _RTOL, search).run(result.displacement)
        if not result.converged:
            raise ConvergenceError(
                f"no equilibrium of gel and body at {motion_mm[2]:.3g} mm from first touch:"
                f" {result.reason} Give a smaller depth_mm, or a larger gel_edge_mm."
            )
        return contact, result

    def press(self, contact: PairContact, result: EquilibriumResult, first_pose: Pose) -> GelPress:
        """Return the press of an equilibrium."""
        u, rows = result.displacement, self.gel_rows
        pose = first_pose.copy()
        pose[:3, 3] += rotate_vectors(first_pose, contact.motion_mm)
        at_pairs = contact.pair_forces(u)
        loaded = at_pairs.any(axis=1)
        support = self._search(contact, _RTOL).support_forces(result)
        return GelPress(
            pose,
            first_pose,
            self.parts.positions[rows],
            u[rows],
            -contact.at(u).forces[rows],
            self.body_points[loaded],
            rotate_vectors(pose, at_pairs[loaded]),
            rotate_vectors(pose, u[self.body_rows]),
            rotate_vectors(pose, support[self.body_rows].sum(axis=0)),
        )

    def _search(self, contact: PairContact, rtol: float, after: Newton | None = None) -> Newton:
        options, nothing = NewtonOptions(rtol=rtol), np.zeros((self.parts.n_nodes, 3))
        return Newton(
            self.assembly, self.pool, self.youngs, nothing, self.supports, options, after,
            contact=contact,
        )  # fmt: skip

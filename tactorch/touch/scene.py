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
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from tactorch.errors import ConfigError
from tactorch.fem import ELEMENTS, Supports
from tactorch.mesh import TetMesh
from tactorch.phantoms import Phantom
from tactorch.recording import MaterialSpec
from tactorch.sensor.description import SensorDescription
from tactorch.sensor.gel import GelMesh
from tactorch.sensor.poses import Pose, rotate_vectors
from tactorch.touch.coupled import Coupled, CoupledState, check_material
from tactorch.touch.options import TouchOptions
from tactorch.touch.pairing import ELEMENT, Facing, face_each_other


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
        check_material(self.material, self.sensor.gel.material)

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
        fixed = np.repeat(self.held[:, None], 3, axis=1)
        coupled = Coupled(
            facing, self.mesh, self.gel, self.material, Supports(fixed=fixed),
            body_mpa=float(np.median(self.youngs)),
            depth_mm=max(float(motion[2]) for motion in motions_mm),
            sticks=self.options.friction == "stick",
        )  # fmt: skip
        presses, u, youngs = [], None, coupled.youngs(self.youngs)
        for motion in motions_mm:
            state = coupled.solve(youngs, np.asarray(motion, dtype=float), u)
            u = state.displacement
            presses.append(_press(coupled, state, first_pose))
        return presses


def held_nodes(mesh: TetMesh, side: str, fraction: float) -> Bool[np.ndarray, " n"]:
    """Return the nodes within a fraction of the extent of a mesh from a side of its box."""
    axis = "xyz".index(side[0])
    low, high = mesh.bounds[:, axis]
    away = mesh.points[:, axis] - low if side[1] == "-" else high - mesh.points[:, axis]
    return np.asarray(away <= fraction * (high - low) + 1e-9 * mesh.diagonal)


def _press(coupled: Coupled, state: CoupledState, first_pose: Pose) -> GelPress:
    """Return the press of an equilibrium."""
    u, contact, rows = state.displacement, state.contact, coupled.face_rows
    pose = first_pose.copy()
    pose[:3, 3] += rotate_vectors(first_pose, contact.motion_mm)
    at_pairs = contact.pair_forces(u)
    loaded = at_pairs.any(axis=1)
    support = state.newton.support_forces(state.result)[coupled.body_rows]
    return GelPress(
        pose,
        first_pose,
        coupled.parts.positions[rows],
        u[rows],
        -contact.at(u).forces[rows],
        coupled.body_points[loaded],
        rotate_vectors(pose, at_pairs[loaded]),
        rotate_vectors(pose, u[coupled.body_rows]),
        rotate_vectors(pose, support.sum(axis=0)),
    )

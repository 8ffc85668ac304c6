"""Presses from the frames of a contact, for batch and streaming recording."""

import logging
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Float, Int

from tactorch.config import Options, option
from tactorch.errors import ConfigError, ConvergenceError
from tactorch.mesh import FACE_NAMES, TetMesh, face_nodes
from tactorch.recording import Press
from tactorch.sensor.chain import SensorChain
from tactorch.sensor.contact import ContactOptions, build_press
from tactorch.sensor.poses import Poses
from tactorch.sensor.recorder.detector import ContactInterval
from tactorch.sensor.recorder.first_contact import first_pose_by_depth, first_pose_by_shape
from tactorch.sensor.recorder.objects import VirtualCube

_log = logging.getLogger(__name__)
_MIN_ALIGNMENT = np.sqrt(0.5)  # cosine between a side's normal and the press direction
_FLATNESS = 2e-3  # of a side, over the object's diagonal

OPPOSITE = "opposite"
Side = Literal["opposite", "x-", "x+", "y-", "y+", "z-", "z+"]


@dataclass(frozen=True)
class Fixture(Options):
    """Support of the object."""

    side: Side = option(
        OPPOSITE,
        "Supported flat side of the object, or opposite: the side opposite to each press",
    )
    kind: Literal["fixed", "springs"] = option("fixed", "Fixed nodes, or a spring on each node")
    spring_n_per_mm: float = option(1.0, "Stiffness of each spring", unit="N/mm", gt=0)

    def supports(self, mesh: TetMesh, direction: Float[np.ndarray, "3"]) -> dict[str, Any]:
        """Return the fields of a `Press` that support the object.

        Args:
            mesh: Object at rest.
            direction: Unit vector of the press in the object frame.

        Raises:
            ConfigError: The object has no flat side opposite to the press.
            MeshError: The named side is not flat.
        """
        opposite = self.side == OPPOSITE
        nodes = opposite_nodes(mesh, direction) if opposite else face_nodes(mesh, self.side)
        if self.kind == "fixed":
            fixed = np.zeros(mesh.points.shape, dtype=bool)
            fixed[nodes] = True
            return {"fixed": fixed}
        springs = np.zeros(mesh.points.shape)
        springs[nodes] = self.spring_n_per_mm
        return {"springs": springs}


def opposite_nodes(mesh: TetMesh, direction: Float[np.ndarray, "3"]) -> Int[np.ndarray, " k"]:
    """Return the nodes of the flat side of the object opposite to a press.

    Raises:
        ConfigError: There is no such side.
    """
    surface, position = mesh.surface, mesh.points @ direction
    distance = (position.max() - position[surface.triangles]).max(axis=1)
    aligned = np.asarray(surface.normals @ direction > _MIN_ALIGNMENT)
    selected = aligned & (distance <= _FLATNESS * mesh.diagonal)
    if not selected.any():
        raise ConfigError(
            "the object has no flat side opposite to a press along"
            f" {np.round(direction, 3).tolist()}; name the supported side: held_side="
            f"{', '.join(FACE_NAMES)}."
        )
    return np.unique(surface.triangles[selected])


@dataclass(frozen=True)
class RecordOptions(Options):
    """Conversion of a session of frames to presses."""

    steps: int = option(3, "Frames per contact, evenly spaced in depth up to the deepest", ge=1)
    min_frames: int = option(1, "Contacts of fewer frames are ignored", ge=1)
    first_contact: Literal["shape", "depth"] = option(
        "shape",
        "Pose of first contact: shape (where the gel and the object meet by their poses), or depth"
        " (extrapolated from the first frames, for unknown shapes)",
    )
    noise_mm: float | None = option(
        None,
        "Standard deviation of the displacements; null estimates it from frames without contact",
        unit="mm", gt=0,
    )  # fmt: skip
    fixture: Fixture = option(factory=Fixture, help="Support of the object")
    contact: ContactOptions | None = option(
        None,
        "Pairing of gel and object; null leaves nodes without contact unobserved, or displaces them"
        " with the sensor in a virtual cube",
    )


@dataclass(frozen=True, eq=False)
class PressBuilder:
    """Builder of presses from the frames of contacts.

    Attributes:
        chain: Calibrated sensor.
        poses: T_object_sensor on the frames' clock.
        mesh: Object at rest.
        options: Conversion options.
        virtual: Whether the mesh is a virtual cube.
        noise_mm: Standard deviation of the displacements.
    """

    chain: SensorChain
    poses: Poses
    mesh: TetMesh
    options: RecordOptions
    virtual: bool
    noise_mm: float

    @staticmethod
    def create(
        chain: SensorChain,
        poses: Poses,
        target: TetMesh | VirtualCube,
        options: RecordOptions,
        contact: ContactInterval,
        measured_noise_mm: float | None,
        mesh: TetMesh | None = None,
    ) -> "PressBuilder":
        """Make a builder; a virtual cube is placed under the given contact.

        Args:
            chain: Calibrated sensor.
            poses: T_object_sensor on the frames' clock.
            target: Object at rest, or a virtual cube.
            options: Conversion options.
            contact: First contact.
            measured_noise_mm: Noise of frames without contact, see `ContactDetector.noise_mm`.
            mesh: Mesh of the virtual cube, if it was placed before.

        Raises:
            ConfigError: A frame of the contact has no pose.
        """
        virtual = isinstance(target, VirtualCube)
        if mesh is None:
            mesh = target if isinstance(target, TetMesh) else _place(target, contact, poses, chain)
        noise_mm = options.noise_mm
        if noise_mm is None:
            noise_mm = max(chain.options.noise_mm, measured_noise_mm or 0.0)
        return PressBuilder(chain, poses, mesh, options, virtual, noise_mm)

    def build(
        self, contact: ContactInterval, number: int
    ) -> Iterator[tuple[int, Press | ConfigError | ConvergenceError]]:
        """Yield the index of each selected frame with its press, or with the error.

        Args:
            contact: Contact.
            number: Number of the contact from 1, for the names of the presses.
        """
        first_pose, step = self._first_pose(contact), 0
        for index in contact.select_frames(self.options.steps):
            name = contact.measurements[index].frame.name
            try:
                press = self._press(
                    contact, index, first_pose, step=step, name=f"contact {number}, {name}"
                )
            except (ConfigError, ConvergenceError) as error:
                _log.warning("Frame '%s' is skipped: %s", name, error)
                yield index, error
            else:
                step += 1
                yield index, press

    def _first_pose(self, contact: ContactInterval) -> Float[np.ndarray, "4 4"]:
        if self.virtual or self.options.first_contact == "depth":
            return _first_pose_by_depth(contact, self.poses)
        gel = self.chain.sensor.gel
        return first_pose_by_shape(self.poses, contact.free_s, contact.times_s[0], self.mesh, gel)

    def _press(
        self,
        contact: ContactInterval,
        index: int,
        first_pose: Float[np.ndarray, "4 4"],
        **fields: Any,
    ) -> Press:
        measurement = contact.measurements[index]
        forces = self.chain.solve_contact(measurement)
        assert forces is not None
        pose = self.poses.at([contact.times_s[index]])[0]
        default = ContactOptions(untouched="sensor" if self.virtual else "unseen")
        return build_press(
            forces, pose, first_pose, self.mesh, measurement.in_contact,
            options=self.options.contact or default, noise_mm=self.noise_mm,
            **self.options.fixture.supports(self.mesh, pose[:3, 2]), **fields,
        )  # fmt: skip


def _first_pose_by_depth(contact: ContactInterval, poses: Poses) -> Float[np.ndarray, "4 4"]:
    times_s, depths_mm = np.array(contact.times_s), np.array(contact.depths_mm)
    return first_pose_by_depth(poses, contact.free_s, times_s, depths_mm)


def _place(
    cube: VirtualCube, contact: ContactInterval, poses: Poses, chain: SensorChain
) -> TetMesh:
    """Place a virtual cube under the center of a contact in its deepest frame."""
    measurement = contact.measurements[int(np.argmax(contact.depths_mm))]
    center_mm = chain.model.points[measurement.in_contact, :2].mean(axis=0)
    return cube.mesh_under(_first_pose_by_depth(contact, poses), center_mm)

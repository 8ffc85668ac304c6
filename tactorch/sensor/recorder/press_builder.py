"""Presses from the frames of a contact, for batch and streaming recording."""

import logging
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from jaxtyping import Float, Int

from tactorch.config import Options, option
from tactorch.errors import ConfigError, ConvergenceError
from tactorch.mesh import FACE_NAMES, TetMesh, face_nodes
from tactorch.recording import Press
from tactorch.sensor.chain import SensorChain
from tactorch.sensor.contact import ContactOptions, Pose, build_press
from tactorch.sensor.poses import Poses
from tactorch.sensor.recorder.detector import ContactInterval
from tactorch.sensor.recorder.first_contact import first_pose_by_depth, first_pose_by_shape
from tactorch.sensor.recorder.objects import VirtualCube

_log = logging.getLogger(__name__)
_MIN_ALIGNMENT = np.sqrt(0.5)  # cosine between a side's normal and the press direction
_FLATNESS = 2e-3  # of a side, over the object's diagonal


@dataclass(frozen=True)
class Fixture(Options):
    """Support of the object."""

    held_side: Literal["opposite", "x-", "x+", "y-", "y+", "z-", "z+"] = option(
        "opposite", "Flat side that is held; opposite: the side opposite to each press"
    )
    held_by: Literal["fixed", "springs"] = option("fixed", "Fixed nodes, or a spring on each node")
    spring_n_per_mm: float = option(1.0, "Stiffness of each spring", unit="N/mm", gt=0)

    def supports(self, mesh: TetMesh, direction: Float[np.ndarray, "3"]) -> dict[str, Any]:
        """Return the fields of a `Press` along `direction` that support the object.

        Raises:
            ConfigError: The object has no flat side opposite to the press.
            MeshError: The named side is not flat.
        """
        opposite = self.held_side == "opposite"
        nodes = opposite_nodes(mesh, direction) if opposite else face_nodes(mesh, self.held_side)
        if self.held_by == "fixed":
            fixed = np.zeros(mesh.points.shape, dtype=bool)
            fixed[nodes] = True
            return {"fixed": fixed}
        springs = np.zeros(mesh.points.shape)
        springs[nodes] = self.spring_n_per_mm
        return {"springs": springs}


def opposite_nodes(mesh: TetMesh, direction: Float[np.ndarray, "3"]) -> Int[np.ndarray, " k"]:
    """Nodes of the flat side of the object opposite to a press."""
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
class RecordOptions(Fixture, ContactOptions):
    """Conversion of a session of frames to presses."""

    steps: int = option(3, "Frames of each contact that become presses, evenly in depth", ge=1)
    min_frames: int = option(1, "Contacts of fewer frames are ignored", ge=1)
    first_contact: Literal["shape", "depth"] = option(
        "shape",
        "Pose of first contact: shape (where the gel and the object meet by their poses), or depth"
        " (extrapolated from the first frames, for unknown shapes)",
    )
    press_noise_mm: float | None = option(
        None,
        "Standard deviation of the displacements of presses; null estimates it from frames without"
        " contact",
        unit="mm", gt=0,
    )  # fmt: skip


class PressBuilder:
    """Builder of presses from the frames of contacts.

    The `mesh` of a virtual cube is placed under the first contact, and None before.
    """

    def __init__(
        self, chain: SensorChain, target: TetMesh | VirtualCube, options: RecordOptions
    ) -> None:
        self.chain, self.options = chain, options
        self.mesh = target if isinstance(target, TetMesh) else None
        self._cube = target if isinstance(target, VirtualCube) else None
        if options.untouched == "auto" and self._cube is not None:
            self.options = replace(options, untouched="sensor")

    def build(
        self, contact: ContactInterval, number: int, poses: Poses, measured_noise_mm: float | None
    ) -> Iterator[tuple[int, Press | ConfigError | ConvergenceError]]:
        """Yield the index of each selected frame with its press, or with the error.

        `number` counts contacts from 1, for the names of the presses. `measured_noise_mm` is that
        of frames without contact.
        """
        first_pose = self._first_pose(contact, poses)
        if self.mesh is None:
            assert self._cube is not None
            deepest = contact.measurements[int(np.argmax(contact.depths_mm))]
            center_mm = self.chain.model.points[deepest.in_contact, :2].mean(axis=0)
            self.mesh = self._cube.mesh_under(first_pose, center_mm)
        noise_mm = self.options.press_noise_mm
        if noise_mm is None:
            noise_mm = max(self.chain.options.noise_mm, measured_noise_mm or 0.0)
        step = 0
        for index in contact.select_frames(self.options.steps):
            measurement = contact.measurements[index]
            name = measurement.frame.name
            pose = poses.at([contact.times_s[index]])[0]
            try:
                forces = self.chain.solve_contact(measurement)
                assert forces is not None
                press = build_press(
                    forces, pose, first_pose, self.mesh, measurement.in_contact,
                    options=self.options, noise_mm=noise_mm, step=step,
                    name=f"contact {number}, {name}",
                    **self.options.supports(self.mesh, pose[:3, 2]),
                )  # fmt: skip
            except (ConfigError, ConvergenceError) as error:
                _log.warning("Frame '%s' is skipped: %s", name, error)
                yield index, error
            else:
                step += 1
                yield index, press

    def _first_pose(self, contact: ContactInterval, poses: Poses) -> Pose:
        times_s, gel = contact.times_s, self.chain.sensor.gel
        if self._cube is None and self.options.first_contact == "shape":
            assert self.mesh is not None
            return first_pose_by_shape(poses, contact.free_s, times_s[0], self.mesh, gel)
        return first_pose_by_depth(poses, contact.free_s, times_s, contact.depths_mm)

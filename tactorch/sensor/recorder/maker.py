"""Presses of the frames of contacts: what recording a whole session and a growing one share."""

import logging
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError, ConvergenceError
from tactorch.mesh import TetMesh
from tactorch.recording import Press
from tactorch.sensor.chain import SensorChain
from tactorch.sensor.contact import ContactOptions, Poses, build_press
from tactorch.sensor.recorder.first_touch import by_depth, by_shape
from tactorch.sensor.recorder.options import RecordOptions
from tactorch.sensor.recorder.region import VirtualCube
from tactorch.sensor.recorder.session import ContactInterval

_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class PressBuilder:
    """Makes presses of the frames of contacts.

    Attributes:
        chain: The calibrated sensor.
        poses: T_object_sensor over the frames' clock.
        mesh: The object at rest.
        options: How frames become presses.
        virtual: Whether the mesh is a virtual cube.
        noise_mm: Standard deviation of the displacements.
    """

    chain: SensorChain
    poses: Poses
    mesh: TetMesh
    options: RecordOptions
    virtual: bool
    noise_mm: float

    def first(self, touch: ContactInterval) -> Float[np.ndarray, "4 4"]:
        """Pose of first touch."""
        if self.virtual or self.options.first_touch == "depth":
            return _first_by_depth(touch, self.poses)
        gel = self.chain.sensor.gel
        return by_shape(self.poses, touch.free_s, touch.times_s[0], self.mesh, gel)

    def presses(
        self, touch: ContactInterval, number: int
    ) -> Iterator[tuple[int, Press | ConfigError | ConvergenceError]]:
        """Yield the index of each frame that stands for a contact, and its press, or why none.

        Args:
            touch: The contact.
            number: Its place among the contacts, from 1, for the presses' names.
        """
        first, step = self.first(touch), 0
        for index in touch.chosen(self.options.steps):
            name = touch.looks[index].frame.name
            try:
                press = self.press(touch, index, first, step, f"contact {number}, {name}")
            except (ConfigError, ConvergenceError) as error:
                _log.warning("Frame '%s' becomes no press: %s", name, error)
                yield index, error
            else:
                step += 1
                yield index, press

    def press(
        self,
        touch: ContactInterval,
        index: int,
        first: Float[np.ndarray, "4 4"],
        step: int,
        name: str,
    ) -> Press:
        """Make the press of one frame of a contact.

        Raises:
            ConfigError: The frame has no pose, or does not fit the object.
            ConvergenceError: No forces deform the gel so.
        """
        look = touch.looks[index]
        contact = self.chain.contact(look)
        assert contact is not None
        pose = self.poses.at([touch.times_s[index]])[0]
        usual = ContactOptions(untouched="sensor" if self.virtual else "unseen")
        return build_press(
            contact, pose, first, self.mesh, look.touched,
            touching=self.options.touching or usual, noise_mm=self.noise_mm, step=step, name=name,
            **self.options.hold.on(self.mesh, pose[:3, 2]),
        )  # fmt: skip


def _first_by_depth(touch: ContactInterval, poses: Poses) -> Float[np.ndarray, "4 4"]:
    return by_depth(poses, touch.free_s, np.array(touch.times_s), np.array(touch.depths_mm))


def region_of(
    target: VirtualCube, touch: ContactInterval, poses: Poses, places_mm: Float[np.ndarray, "k 2"]
) -> TetMesh:
    """Mesh the region under a contact, about the middle of what is touched where it is deepest."""
    look = touch.looks[int(np.argmax(touch.depths_mm))]
    return target.under(_first_by_depth(touch, poses), places_mm[look.touched].mean(axis=0))


def noise_of(shown_mm: float | None, chain: SensorChain, options: RecordOptions) -> float:
    """Return the standard deviation of the displacements, mm: told, or shown and allowed for."""
    if options.noise_mm is not None:
        return float(options.noise_mm)
    return max(float(chain.options.noise_mm), shown_mm or 0.0)

"""From the sensor to the object: poses, and what is carried over."""

from tactorch.sensor.contact.carry import carry_displacements, carry_forces
from tactorch.sensor.contact.pose import Poses, check_pose, moved, read_poses, turned
from tactorch.sensor.contact.press import ContactOptions, build_press, facing

__all__ = [
    "ContactOptions",
    "Poses",
    "build_press",
    "carry_displacements",
    "carry_forces",
    "check_pose",
    "facing",
    "moved",
    "read_poses",
    "turned",
]

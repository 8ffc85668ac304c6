"""From the sensor to the object: poses, and what is carried over."""

from tactorch.sensor.contact.carry import carry_displacements, carry_forces
from tactorch.sensor.contact.pose import Poses, check_pose, moved, read_poses, turned

__all__ = [
    "Poses",
    "carry_displacements",
    "carry_forces",
    "check_pose",
    "moved",
    "read_poses",
    "turned",
]

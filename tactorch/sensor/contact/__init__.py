"""From the sensor to the object: poses, and what is carried over."""

from tactorch.sensor.contact.carry import carry_displacements, carry_forces
from tactorch.sensor.contact.pose import Poses, check_pose, moved, read_poses, turned
from tactorch.sensor.contact.press import Touching, facing, press_of

__all__ = [
    "Poses",
    "Touching",
    "carry_displacements",
    "carry_forces",
    "check_pose",
    "facing",
    "moved",
    "press_of",
    "read_poses",
    "turned",
]

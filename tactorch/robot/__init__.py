"""Robots that press an object in a closed loop: press, map, next press.

- `Robot`: what the driver of a robot implements: `press` takes a `PressCommand` and returns a
  `PressReport`.
- `RobotPresser`: presses by a driver over the nodes of the mesh of the inversion.
- `SimulatedRobot`: a robot with delays, wrong poses and a force limit. The registry `PRESSERS`
  lists drivers by name.
- `RobotSession` and `press_until_known`: the loop, until a `StopRule` is met.
- `pressable_patches`: candidates that lie on the surface as a whole.
"""

from tactorch.robot.driver import PressCommand, PressReport, Robot
from tactorch.robot.presser import RobotPresser
from tactorch.robot.session import RobotSession, press_until_known
from tactorch.robot.simulated import PRESSERS, SimulatedRobot
from tactorch.robot.stop import StopRule, position_width_mm
from tactorch.sampling.candidates import pressable_patches

__all__ = [
    "PRESSERS",
    "PressCommand",
    "PressReport",
    "Robot",
    "RobotPresser",
    "RobotSession",
    "SimulatedRobot",
    "StopRule",
    "position_width_mm",
    "press_until_known",
    "pressable_patches",
]

"""What the driver of a robot implements: a press is commanded, and what was measured comes back.

All values are in mm and N, in the frame of the object's mesh. The driver converts from and to the
frames and units of its robot.
"""

import os
import sys
from dataclasses import dataclass
from pkgutil import resolve_name
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from tactorch.config import Options, option
from tactorch.errors import ConfigError, RobotError

_UNIT_TOLERANCE = 1e-3  # of the length of a direction


@dataclass(frozen=True, eq=False)
class PressCommand:
    """A press that the robot is to carry out.

    Attributes:
        center_mm: Point of the undeformed surface that the middle of the sensor touches, (3,), mm.
        inward: Unit vector along which the sensor pushes, (3,).
        radius_mm: Radius of the sensor's contact area, mm.
        force_n: Force along `inward` at which the press is held and measured, N.
    """

    center_mm: Float[np.ndarray, "3"]
    inward: Float[np.ndarray, "3"]
    radius_mm: float
    force_n: float


@dataclass(frozen=True, eq=False)
class PressReport:
    """What a robot measured while it held a press.

    Attributes:
        center_mm: Point of the undeformed surface that the middle of the sensor touched, by the
            robot's own pose, (3,), mm.
        inward: Unit vector of the push, by the robot's own pose, (3,).
        force_n: Force of the sensor on the object, (3,), N.
        points_mm: Points of the undeformed surface within the contact area, (k, 3), mm.
        displacements_mm: Their displacements since the first touch, (k, 3), mm.
        noise_mm: Standard deviation of a component of a displacement, mm.
        stopped: Reason why the force is less than commanded, such as "force limit"; usually empty.
    """

    center_mm: Float[np.ndarray, "3"]
    inward: Float[np.ndarray, "3"]
    force_n: Float[np.ndarray, "3"]
    points_mm: Float[np.ndarray, "k 3"]
    displacements_mm: Float[np.ndarray, "k 3"]
    noise_mm: float
    stopped: str = ""

    def check(self) -> None:
        """Refuse values that no press has.

        Raises:
            RobotError: values are not finite, arrays are of other shapes, the direction is no unit
                vector, the sensor pulls, or the noise is not positive.
        """
        for name in ("center_mm", "inward", "force_n"):
            _check_array(name, getattr(self, name), (3,))
        count = len(self.points_mm)
        for name in ("points_mm", "displacements_mm"):
            _check_array(name, getattr(self, name), (count, 3))
        if abs(float(np.linalg.norm(self.inward)) - 1.0) > _UNIT_TOLERANCE:
            raise RobotError(f"inward={self.inward.tolist()} of the report is no unit vector.")
        push = float(np.dot(self.force_n, self.inward))
        if not push > 0:
            raise RobotError(
                f"force_n={np.asarray(self.force_n).tolist()} N of the report does not push along "
                f"inward ({push:.3g} N): report the force of the sensor on the object, in the "
                "frame of the mesh."
            )
        if not (np.isfinite(self.noise_mm) and self.noise_mm > 0):
            raise RobotError(f"noise_mm={self.noise_mm} of the report: give a number above 0.")


def _check_array(name: str, value: object, shape: tuple[int, ...]) -> None:
    array = np.asarray(value)
    if array.shape != shape or array.dtype.kind not in "fiu" or not np.isfinite(array).all():
        raise RobotError(
            f"{name} of the report has shape {array.shape} and must be finite numbers of shape "
            f"{shape}."
        )


@runtime_checkable
class Robot(Protocol):
    """Driver of a robot with a tactile sensor."""

    def press(self, command: PressCommand) -> PressReport:
        """Move above the point, press until the force is reached, measure, and retract.

        The robot must not move by itself beyond this: it is at rest, and away from the object, when
        the call returns or raises.

        Raises:
            PoseRefusedError: the pose cannot be reached; another candidate is tried.
            ForceLimitError: the press was refused for its force; another candidate is tried. A
                press that was stopped at the limit may be reported instead.
            RobotError: any other failure that another press may not have. Other exceptions, too,
                mark the candidate as failed.
        """


@dataclass(frozen=True)
class CustomRobot(Options):
    """Driver of a user's robot, see the documentation; presser=MODULE:CLASS is short for it."""

    section: ClassVar[str] = "presser"

    path: str = option(help="Import path of the driver's class, MODULE:CLASS")
    settings: dict[str, Any] = option(factory=dict, help="Keyword arguments of the class, by name")

    def build(self) -> Robot:
        """Import the class and make the driver; the working directory is searched too.

        Raises:
            ConfigError: the class cannot be imported or made, or has no `press`.
        """
        if not all(self.path.partition(":")):
            raise ConfigError(
                f"presser.path={self.path}: give MODULE:CLASS, as mylab.robot:MyRobot."
            )
        if os.getcwd() not in sys.path:
            sys.path.append(os.getcwd())
        try:
            robot = resolve_name(self.path)(**self.settings)
        except Exception as error:  # whatever code of another package raises
            raise ConfigError(
                f"presser={self.path} cannot be made ({type(error).__name__}: {error}); check the "
                "import path and presser.settings."
            ) from error
        if not isinstance(robot, Robot):
            raise ConfigError(
                f"presser={self.path} has no method press(command); see the documentation."
            )
        return robot

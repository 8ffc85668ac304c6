"""A user's driver, named by its import path."""

import os
import sys
from dataclasses import dataclass
from pkgutil import resolve_name
from typing import Any, ClassVar

from tactorch.config import Options, option
from tactorch.errors import ConfigError
from tactorch.robot.driver import Robot


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

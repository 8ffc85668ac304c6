"""Reports of drivers, and the errors that name what is wrong with them."""

from typing import Any

import numpy as np
import pytest
from robot_fakes import DOWN, FakeRobot

from tactorch.errors import RobotError
from tactorch.robot import PressCommand, PressReport, Robot, SimulatedRobot

COMMAND = PressCommand(np.array([5.0, 5.0, 10.0]), DOWN, 2.0, 0.1)


@pytest.fixture
def report() -> PressReport:
    return FakeRobot().press(COMMAND)


def test_drivers_have_the_protocol() -> None:
    assert isinstance(FakeRobot(), Robot)
    assert isinstance(SimulatedRobot(), Robot)
    assert not isinstance(object(), Robot)


def test_a_complete_report_is_accepted(report: PressReport) -> None:
    report.check()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"center_mm": np.array([1.0, 2.0])}, "center_mm of the report has shape"),
        ({"force_n": np.array([0.0, 0.0, np.nan])}, "force_n of the report"),
        ({"force_n": np.array([0.0, 0.0, 0.1])}, "does not push along"),
        ({"inward": np.array([0.0, 0.0, -2.0])}, "no unit vector"),
        ({"points_mm": np.zeros((4, 3))}, "displacements_mm of the report has shape"),
        ({"noise_mm": 0.0}, "noise_mm=0.0"),
    ],
)
def test_a_report_that_cannot_be_is_refused(
    report: PressReport, changes: dict[str, Any], message: str
) -> None:
    for name, value in changes.items():  # past the checks of shapes that only tests have
        object.__setattr__(report, name, value)
    with pytest.raises(RobotError, match=message):
        report.check()

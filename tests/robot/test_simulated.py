"""The simulated robot: delays, wrong poses, noise, the force limit and refused poses."""

from typing import Any

import numpy as np
import pytest
from robot_fakes import DOWN

from tactorch.errors import ConfigError, ForceLimitError, PoseRefusedError
from tactorch.phantoms.cubes import UniformCube
from tactorch.robot import PRESSERS, PressCommand, SimulatedRobot
from tactorch.robot.driver import CustomRobot

PLACES = [(x, y) for x in np.linspace(3.0, 7.0, 12) for y in np.linspace(3.0, 7.0, 12)]


def command(x: float = 5.0, y: float = 5.0, force_n: float = 0.1) -> PressCommand:
    return PressCommand(np.array([x, y, 10.0]), DOWN, 2.0, force_n)


@pytest.fixture
def rigid(monkeypatch: pytest.MonkeyPatch) -> None:
    """Skip the mechanics: the object does not move."""

    def still(self: Any, patch: Any, force_n: float, points: np.ndarray) -> np.ndarray:
        return np.zeros_like(points)

    monkeypatch.setattr(SimulatedRobot, "_displacements", still)


def make(**settings: Any) -> SimulatedRobot:
    return SimulatedRobot(phantom=UniformCube(), edge_mm=4.0, **settings)


@pytest.mark.usefixtures("rigid")
def test_delays_are_counted_or_waited_for() -> None:
    waits: list[float] = []
    robot = make(move_seconds=3.0, press_seconds=2.0, sleep=waits.append)
    robot.press(command())
    assert robot.elapsed_seconds == 5.0
    assert waits == []
    robot = make(move_seconds=3.0, press_seconds=2.0, real_time=True, sleep=waits.append)
    robot.press(command())
    assert waits == [3.0, 2.0]


@pytest.mark.usefixtures("rigid")
def test_noise_of_poses_and_displacements_is_as_stated() -> None:
    robot = make(
        pose_deviation_mm=0.2, report_deviation_mm=0.05, tilt_deviation_deg=1.0, noise_mm=0.004
    )
    reports = [robot.press(command(x, y)) for x, y in PLACES]
    commanded = np.array([[x, y, 10.0] for x, y in PLACES])
    off = np.array([report.center_mm for report in reports]) - commanded
    assert off[:, :2].std() == pytest.approx(np.hypot(0.2, 0.05), rel=0.15)
    # Measured points are where the robot believes that they are.
    middles = np.array([report.points_mm.mean(axis=0) for report in reports])
    np.testing.assert_allclose(middles - commanded, off, atol=0.02)
    tilts = [np.degrees(np.arccos(-report.inward[2])) for report in reports]
    assert np.sqrt(np.mean(np.square(tilts)) / 2) == pytest.approx(1.0, rel=0.2)
    moved = np.concatenate([report.displacements_mm for report in reports])
    assert moved.std() == pytest.approx(0.004, rel=0.05)
    assert reports[0].noise_mm == 0.004


@pytest.mark.usefixtures("rigid")
def test_it_is_exact_without_deviations_and_repeats_with_them() -> None:
    exact = make(
        pose_deviation_mm=0, report_deviation_mm=0, tilt_deviation_deg=0, force_deviation=0
    )
    report = exact.press(command())
    np.testing.assert_allclose(report.center_mm, [5.0, 5.0, 10.0], atol=1e-9)
    np.testing.assert_allclose(report.force_n, [0.0, 0.0, -0.1])
    same = [make().press(command()).center_mm for _ in range(2)]
    np.testing.assert_array_equal(*same)
    assert not np.array_equal(make(seed=1).press(command()).center_mm, same[0])


@pytest.mark.usefixtures("rigid")
def test_the_force_limit_stops_or_refuses() -> None:
    settings = {"max_force_n": 0.06, "force_deviation": 0.0}
    report = make(**settings).press(command(force_n=0.1))
    assert report.stopped == "force limit"
    assert np.linalg.norm(report.force_n) == pytest.approx(0.06)
    assert make(**settings).press(command(force_n=0.05)).stopped == ""
    with pytest.raises(ForceLimitError, match=r"needs 0\.1 N, more than the limit of 0\.06 N"):
        make(at_limit="refuse", **settings).press(command(force_n=0.1))


@pytest.mark.usefixtures("rigid")
def test_poses_are_refused_at_the_stated_rate_and_stay_refused() -> None:
    robot, refused = make(failure_rate=0.3), []
    for x, y in PLACES:
        try:
            robot.press(command(x, y))
        except PoseRefusedError:
            refused.append((x, y))
    assert len(refused) == pytest.approx(0.3 * len(PLACES), rel=0.35)
    with pytest.raises(PoseRefusedError, match="is refused"):
        robot.press(command(*refused[0]))


def test_what_is_pressed_sinks_in_proportion_to_the_force() -> None:
    robot = make(pose_deviation_mm=0, tilt_deviation_deg=0, noise_mm=1e-9)
    small, large = (robot.press(command(force_n=f)) for f in (0.01, 0.02))
    assert small.displacements_mm[0, 2] < -0.002
    ratio = large.displacements_mm[0, 2] / small.displacements_mm[0, 2]
    assert ratio == pytest.approx(2.0, rel=0.05)
    assert np.linalg.norm(small.points_mm - [5, 5, 10], axis=1).max() < 2.2


def test_drivers_are_registered_by_name() -> None:
    assert PRESSERS["simulated"] is SimulatedRobot
    robot = PRESSERS.build({"name": "simulated", "max_force_n": 2.0})
    assert robot.max_force_n == 2.0


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("nothing", "give MODULE:CLASS"),
        ("no_such_package.robot:MyRobot", "cannot be made"),
        ("collections:OrderedDict", "no method press"),
    ],
)
def test_a_driver_that_cannot_be_used_is_named(path: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        CustomRobot(path=path).build()


def test_a_driver_is_imported_with_its_settings() -> None:
    robot = CustomRobot(path="robot_fakes:FakeRobot", settings={"changes": {"noise_mm": 1.0}})
    assert robot.build().press(command()).noise_mm == 1.0

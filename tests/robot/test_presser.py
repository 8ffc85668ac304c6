"""Reports as presses over the nodes of a mesh, and failures of drivers."""

import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from robot_fakes import FakeRobot, quadratic

from tactorch.errors import ForceLimitError, PoseRefusedError, RobotError, RobotTimeoutError
from tactorch.robot import RobotPresser
from tactorch.robot.contact import across
from tactorch.sampling import Patch, Presser

Make = Callable[..., RobotPresser]


@pytest.fixture(scope="module")
def predicted(make_presser: Make, patches: list[Patch]) -> Any:
    """A presser, a press and its prediction on a finer mesh."""
    presser = make_presser(FakeRobot())
    press = presser.press(patches[1])
    return presser, press, presser.fine_prediction(press, 0.2)


def test_displacements_at_nodes_are_those_of_the_points(
    make_presser: Make, patches: list[Patch]
) -> None:
    presser = make_presser(FakeRobot())
    assert isinstance(presser, Presser)
    press = presser.press(patches[0])
    seen = press.observed.all(axis=1)
    np.testing.assert_allclose(
        press.displacement[seen], quadratic(presser.mesh.points[seen]), atol=1e-12
    )
    assert seen.sum() >= 4
    assert np.isnan(press.displacement[~seen]).all()
    # Many points are averaged.
    assert 0.1 * 0.002 < press.noise_mm < 0.8 * 0.002


def test_the_command_has_the_force_of_the_pressure(
    make_presser: Make, patches: list[Patch]
) -> None:
    robot = FakeRobot()
    make_presser(robot).press(patches[0])
    (command,) = robot.commands
    assert command.force_n == pytest.approx(0.01 * np.pi * 2.5**2)
    np.testing.assert_array_equal(command.center_mm, patches[0].center)


def test_forces_are_those_measured_at_the_reported_pose(
    make_presser: Make, patches: list[Patch]
) -> None:
    shift = np.array([0.5, -0.4, 0.0])
    force = np.array([0.01, 0.0, -0.12])
    robot = FakeRobot(changes={"center_mm": patches[0].center + shift, "force_n": force})
    presser = make_presser(robot)
    press = presser.press(patches[0])
    np.testing.assert_allclose(press.total_force, force)
    moved = replace(patches[0], center=patches[0].center + shift).forces(presser.mesh)
    np.testing.assert_array_equal(press.forces.any(axis=1), moved.any(axis=1))
    assert presser.seen[press.name].patch.center == pytest.approx(patches[0].center + shift)


@pytest.mark.parametrize(
    ("error", "kind"),
    [
        (PoseRefusedError("out of reach"), PoseRefusedError),
        (ForceLimitError("too hard"), ForceLimitError),
        (OSError("cable"), RobotError),
        (TimeoutError("no answer"), RobotError),
    ],
)
def test_errors_of_a_driver_are_errors_of_the_robot(
    error: Exception, kind: type[Exception], make_presser: Make, patches: list[Patch]
) -> None:
    with pytest.raises(kind, match=str(error)):
        make_presser(FakeRobot(failures={1: error})).press(patches[0])


def test_a_driver_that_hangs_is_left(make_presser: Make, patches: list[Patch]) -> None:
    release, made = threading.Event(), []

    class Hanging(FakeRobot):
        def press(self, command: Any) -> Any:
            made.append(command)
            release.wait(20.0)
            return super().press(command)

    presser = make_presser(Hanging(), timeout_seconds=0.05)
    with pytest.raises(RobotTimeoutError, match=r"the press did not end within 0\.05 s"):
        presser.press(patches[0])
    with pytest.raises(RobotTimeoutError, match="the press before it"):
        presser.press(patches[1])
    assert len(made) == 1  # two motions at once would be dangerous
    release.set()
    presser._calls[-1].result(timeout=20.0)
    assert presser.press(patches[1]).observed.any()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"points_mm": np.zeros((2, 3)), "displacements_mm": np.zeros((2, 3))}, "only 0 nodes"),
        ({"noise_mm": -1.0}, "noise_mm=-1"),
    ],
)
def test_reports_that_cannot_be_used(
    changes: dict[str, Any], message: str, make_presser: Make, patches: list[Patch]
) -> None:
    with pytest.raises(RobotError, match=message):
        make_presser(FakeRobot(changes=changes)).press(patches[0])


def test_what_is_no_report_is_named(make_presser: Make, patches: list[Patch]) -> None:
    class Wrong(FakeRobot):
        def press(self, command: Any) -> Any:
            return None

    with pytest.raises(RobotError, match="returned NoneType"):
        make_presser(Wrong()).press(patches[0])


def test_poses_survive_as_plain_values(make_presser: Make, patches: list[Patch]) -> None:
    presser = make_presser(FakeRobot())
    name = presser.press(patches[1]).name
    again = make_presser(FakeRobot())
    again.restore(presser.plain())
    np.testing.assert_array_equal(again.seen[name].patch.center, patches[1].center)
    assert again.seen[name].patch.radius_mm == 2.5


@pytest.mark.slow
def test_the_finer_mesh_agrees_far_from_the_rim(predicted: Any) -> None:
    presser, press, prediction = predicted
    assert prediction is not None
    better, present, per_mm = prediction
    assert per_mm.shape == (2, *better.shape)
    held = presser.held
    assert not better[held].any()
    loaded = press.observed.any(axis=1)
    error = np.linalg.norm((better - present)[loaded]) / np.linalg.norm(better[loaded])
    assert 1e-3 < error < 0.3
    assert presser.fine_prediction(replace(press, name="another"), 0.2) is None


def test_nodes_at_the_edge_of_the_points_have_more_noise(
    make_presser: Make, patches: list[Patch]
) -> None:
    presser = make_presser(FakeRobot())
    press = presser.press(patches[2])
    assert press.weights is not None
    assert press.noise_mm is not None
    seen = np.flatnonzero(press.observed.all(axis=1))
    deviations = press.noise_mm / press.weights[seen, 0]
    # By the weights of the points, whose noise is independent.
    rows = presser.seen[press.name].rows
    np.testing.assert_allclose(deviations, 0.002 * np.linalg.norm(rows, axis=1))
    radii = np.linalg.norm(presser.mesh.points[seen] - patches[2].center, axis=1)
    assert deviations[radii.argmax()] > 1.05 * deviations[radii.argmin()]


@pytest.mark.slow
def test_a_wrong_position_changes_the_displacements_as_predicted(predicted: Any) -> None:
    """A press at another place with its points, whose position is reported as before."""
    presser, press, prediction = predicted
    seen = presser.seen[press.name]
    step = 0.1 * across(seen.patch.inward)[0]
    there = presser._fine(seen.moved(step, presser.mesh), press.total_force, 0.2)
    change, told = there - prediction.better, 0.1 * prediction.per_mm[0]
    assert np.linalg.norm(change) > 0.005 * np.linalg.norm(prediction.better)
    assert np.linalg.norm(change - told) < 0.3 * np.linalg.norm(change)

"""The whole loop with a simulated robot: it ends, finds the ball, and survives failures."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tactorch.errors import RobotError
from tactorch.inverse.search.draft_errors import DraftOptions
from tactorch.mesh import box_mesh
from tactorch.phantoms.cubes import CubeSphere, UniformCube
from tactorch.recording import MaterialSpec, Recording
from tactorch.robot import (
    RobotPresser,
    RobotSession,
    SimulatedRobot,
    StopRule,
    press_until_known,
)
from tactorch.sampling import LoopOptions, LoopResult, Patch

pytestmark = pytest.mark.slow
BALL = CubeSphere(depth=0.35, radius=0.2)
DOWN = np.array([0.0, 0.0, -1.0])
PLACES = [(5, 5), (3.2, 5), (5, 3.2), (6.8, 5), (5, 6.8), (3.2, 3.2), (6.8, 6.8)]


@pytest.fixture
def run(tmp_path: Path) -> Callable[..., tuple[RobotSession, LoopResult, Any]]:
    def run(
        phantom: Any, stop: StopRule, max_presses: int | None = None, **settings: Any
    ) -> tuple[RobotSession, LoopResult, Any]:
        robot = SimulatedRobot(
            phantom=phantom, edge_mm=2.0, conforming=False, noise_mm=0.002, **settings
        )
        mesh = box_mesh(10.0, 5, tets_per_cell=5)
        law = MaterialSpec("neo_hookean", 0.45)
        presser = RobotPresser(robot, mesh, mesh.points[:, 2] < 1e-6, law, 0.015, 0.002)
        patches = [Patch(np.array([x, y, 10.0]), DOWN, 2.0) for x, y in PLACES]
        session = RobotSession(presser, patches, tmp_path, stop)
        loop = LoopOptions(poll_seconds=0.01, max_presses=max_presses, max_iterations=3)
        draft = DraftOptions(pose_deviation_mm=0.05)
        return session, press_until_known(session, options=loop, draft=draft), robot

    return run


def test_the_ball_is_found_and_the_run_ends(run: Any, tmp_path: Path) -> None:
    session, ended, robot = run(BALL, StopRule(width_mm=1.6), press_seconds=2.0, failure_rate=0.15)
    assert "mm wide after" in ended.reason
    lump = ended.update.result.lumps[0]
    assert np.linalg.norm(lump.inclusion.center_mm - [5.0, 5.0, 6.5]) < 0.8
    presses = len(session.pressed)
    assert 3 <= presses <= len(PLACES)
    assert robot.elapsed_seconds == 2.0 * presses
    recording = Recording.load(tmp_path / "recording.h5", check_units=False)
    assert len(recording.presses) == presses
    state = json.loads((tmp_path / "robot.json").read_text())
    assert len(state["pressed"]) == presses


def test_nothing_is_found_in_a_uniform_cube_and_the_run_ends(run: Any) -> None:
    session, ended, _ = run(UniformCube(), StopRule(empty_presses=4))
    assert "nothing was found" in ended.reason
    assert len(session.pressed) == 4
    assert not ended.update.result.lumps


def test_a_run_continues_after_a_failure_of_the_robot(
    run: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    stop = StopRule(width_mm=1e-3, empty_presses=50)
    _, ended, _ = run(BALL, stop, max_presses=2)
    assert "2 presses" in ended.reason
    history = ended.history
    with monkeypatch.context() as context:

        def broken(*given: Any) -> None:
            raise RobotError("the cable is off")

        context.setattr(SimulatedRobot, "press", broken)
        session, ended, _ = run(BALL, stop, max_presses=4)
        assert "one after the other (the cable is off)" in ended.reason
        assert len(session.failed) == 5
        assert ended.history == history
    session, ended, _ = run(BALL, stop, max_presses=3)
    assert ended.reason == "3 presses (max_presses) were made"
    assert len(session.pressed) == 3
    assert not session.failed

"""Presses on request of a loop, failures of the robot, and continued runs."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from robot_fakes import FakeRobot, entry

from tactorch.errors import ConfigError, FileError, PoseRefusedError, RobotError
from tactorch.recording import Recording
from tactorch.robot import RobotSession
from tactorch.robot.session import STATE
from tactorch.sampling import Observer

Make = Callable[..., RobotSession]


class Notes(Observer):
    def __init__(self) -> None:
        self.notes: list[str] = []

    def show_message(self, text: str) -> None:
        self.notes.append(text)


def test_it_presses_once_each_time_the_loop_waits(make_session: Make) -> None:
    robot = FakeRobot()
    session = make_session(robot)
    session.waiting(0, 0.0)
    session.waiting(0, 0.0)  # the loop has not read the first one yet
    assert len(robot.commands) == 1
    session.waiting(1, 0.0)
    presses = Recording.load(session.recording, check_units=False).presses
    assert len(presses) == len(robot.commands) == 2
    # Without a suggestion, the place farthest from those pressed.
    assert session.pressed == (0, 1)


def test_it_presses_where_the_loop_suggests(make_session: Make) -> None:
    session = make_session(FakeRobot())
    session.waiting(0, 0.0)
    session._next = 3
    session.waiting(1, 0.0)
    assert session.pressed == (0, 3)


def test_a_failure_marks_the_place_and_another_is_pressed(make_session: Make) -> None:
    notes = Notes()
    robot = FakeRobot(failures={1: PoseRefusedError("out of reach")})
    session = make_session(robot, observers=(notes,))
    session.waiting(0, 0.0)
    assert session.failed == {0: "out of reach"}
    assert not session.recording.exists()
    assert notes.notes == ["The press at (5.00, 5.00, 10.00) mm failed: out of reach"]
    assert session.end() == ""
    session.waiting(0, 0.1)
    assert session.pressed == (1,)
    recording = Recording.load(session.recording, check_units=False)
    assert set(session.candidates(recording).pressed) == {0, 1}


def test_failures_one_after_the_other_end_the_run(make_session: Make) -> None:
    robot = FakeRobot(failures={k: RobotError("stopped") for k in (1, 2, 4)})
    session = make_session(robot, max_failures=2)
    session.waiting(0, 0.0)
    session.waiting(0, 0.0)
    assert session.end() == "the robot failed 2 times one after the other (stopped)"
    # The robot was out of order: a run that is continued tries the candidates again.
    again = make_session(FakeRobot(), max_failures=2)
    assert again.failed == {}
    assert again.end() == ""
    again.waiting(0, 0.0)
    assert again.pressed == (0,)


def test_a_press_between_resets_the_count(make_session: Make) -> None:
    robot = FakeRobot(failures={k: RobotError("stopped") for k in (1, 3)})
    session = make_session(robot, max_failures=2)
    for done in (0, 0, 1):
        session.waiting(done, 0.0)
    assert len(session.failed) == 2
    assert session.end() == ""


def test_a_robot_that_always_fails_ends_the_run(make_session: Make) -> None:
    robot = FakeRobot(failures={k: RobotError("off") for k in range(1, 9)})
    session = make_session(robot, max_failures=9)
    for _ in range(6):
        session.waiting(0, 0.0)
    assert len(robot.commands) == 4  # each candidate once
    assert session.end() == "the robot failed at all candidates"


def test_the_end_is_that_of_the_stop_rule_for_all_presses(make_session: Make) -> None:
    session = make_session(FakeRobot())
    for done in range(3):
        session.waiting(done, 0.0)
    session.resumed([entry(2, 0.5), entry(3, 0.5)])
    assert "0.5 mm wide" in session.end()
    session.resumed([entry(2, 0.5)])  # two of three presses
    assert session.end() == ""


def test_the_run_ends_when_all_candidates_are_pressed(make_session: Make) -> None:
    session = make_session(FakeRobot())
    for done in range(6):
        session.waiting(done, 0.0)
    assert len(session.pressed) == 4
    session.resumed([entry(4, 1.5)])
    assert session.end() == "all candidates were pressed, or failed"
    with pytest.raises(ConfigError, match="all candidates"):
        session.candidates(Recording.load(session.recording, check_units=False))


def test_a_killed_run_continues_with_its_presses_and_poses(make_session: Make) -> None:
    first = make_session(FakeRobot(failures={2: PoseRefusedError("out of reach")}))
    for done in (0, 1, 1):
        first.waiting(done, 0.0)
    robot = FakeRobot()
    again = make_session(robot)
    assert again.pressed == first.pressed
    assert again.failed == first.failed
    assert again.presser.plain() == first.presser.plain()
    again.waiting(2, 0.0)
    assert len(again.pressed) == 3
    assert len(Recording.load(again.recording, check_units=False).presses) == 3


def test_a_press_that_was_not_recorded_before_the_kill_is_made_again(
    make_session: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = make_session(FakeRobot())
    session.waiting(0, 0.0)

    def killed(*given: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("tactorch.robot.session.append_press", killed)
    with pytest.raises(KeyboardInterrupt):
        session.waiting(1, 0.0)
    assert make_session(FakeRobot()).pressed == (0,)


def test_a_press_that_the_loop_does_not_take_counts_as_failed(make_session: Make) -> None:
    session = make_session(FakeRobot())
    session.waiting(0, 0.0)
    session.waiting(0, 60.0)
    assert session.pressed == ()
    assert "cannot be used" in session.failed[0]


def test_other_candidates_are_refused(make_session: Make, tmp_path: Path) -> None:
    session = make_session(FakeRobot())
    session.waiting(0, 0.0)
    state = tmp_path / STATE
    state.write_text(state.read_text().replace("6.0", "6.5"))
    with pytest.raises(FileError, match="other candidates"):
        make_session(FakeRobot())

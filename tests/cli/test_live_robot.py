"""`tactorch live` with a robot that presses by itself."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tactorch.cli.overrides import expanded


def test_an_import_path_is_the_choice_of_a_driver() -> None:
    words = ["presser=mylab.robot:MyRobot", "stop.width_mm=1"]
    assert expanded("live", words) == [
        "presser=driver", "presser.path='mylab.robot:MyRobot'", "stop.width_mm=1"
    ]  # fmt: skip
    assert expanded("live", ["presser=simulated"]) == ["presser=simulated"]
    assert expanded("invert", words) == words


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["presser=no_such_lab.robot:MyRobot"], "no_such_lab.robot:MyRobot cannot be made"),
        (["presser=robot_fakes:FakeRobot"], "'robot.mesh' is missing"),
        (["presser=simulated", "recording=a.h5"], "leave out recording="),
        (["presser=simulated", "stop.width_mm=0"], "stop.width_mm=0: give a number above 0"),
        (["presser=simulated", "robot.radius_mm=6"], "use a smaller"),
        (["presser=simulated", "robot.approach=[0,0,0]"], "give a direction"),
        (["presser=unknown"], "presser=unknown is unknown"),
    ],
)
def test_what_cannot_be_is_refused(
    tactorch: Callable[..., Any], given: list[str], message: str
) -> None:
    done = tactorch("live", *given, "run_dir=run")
    assert done.status == 2
    assert message in done.err
    assert "Traceback" not in done.err
    assert not Path("run/robot.json").exists()


@pytest.mark.slow
def test_a_simulated_robot_presses_and_the_run_continues(tactorch: Callable[..., Any]) -> None:
    given = (
        *("presser=simulated", "presser.edge_mm=4", "presser.conforming=false"),
        *("presser.failure_rate=0.2", "robot.candidates=6", "robot.approach=[0,0,-1]"),
        *("plots=false", "max_iterations=2", "poll_seconds=0.01", "run_dir=run"),
    )
    done = tactorch("live", *given, "max_presses=1")
    assert done.status == 0, done.err
    assert "1 presses (max_presses) were made" in done.out
    again = tactorch("live", *given, "max_presses=2")
    assert again.status == 0, again.err
    assert "continuing a run of 1 presses" in again.out
    assert len(json.loads(Path("run/robot.json").read_text())["pressed"]) == 2
    history = [json.loads(line) for line in Path("run/history.jsonl").read_text().splitlines()]
    assert history[-1]["press"] == 2
    assert history[-1]["next_rule"] == "lump_position"
    assert '"ended":true' in Path("run/live.html").read_text().replace(" ", "")

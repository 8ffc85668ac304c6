"""Bags by commands alone: a palpation to a recording, a sensor's session to a recording."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")

from tactorch.recording import Recording
from tactorch.sensor.frames import read_image

from ..ros2.bags import POSE, Robot, pose, write_bag
from ..ros2.test_unpack import IMAGE, image
from .test_sensor import calibration, files
from .test_sensor_record import HEIGHTS_MM, SMALL, poses, settings

__all__ = ["calibration", "files"]  # fixtures
DOWN = (1.0, 0.0, 0.0, 0.0)


def test_a_bag_of_a_palpation_becomes_a_recording(tactorch: Any, tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", Robot().topics(), "mcap")
    done = tactorch(
        "import", "format=ros2", f"path={bag}", "out=p.h5", "format.radius_mm=3",
        "format.depth_mm=9", "format.edge_mm=5", "format.wrench_topic=/wrench",
    )  # fmt: skip
    assert done.status == 0, done.err
    assert "presses by a probe" in done.out
    assert len({press.name for press in Recording.load("p.h5").presses}) == 16
    done = tactorch("import", "format=ros2", f"path={bag}", "out=q.h5")
    assert done.status != 0
    assert "give radius_mm" in done.err
    assert not Path("q.h5").exists()


@pytest.mark.slow
def test_a_session_of_a_bag_is_recorded_as_its_files_are(
    tactorch: Any, files: Path, calibration: Path, tmp_path: Path
) -> None:
    times = [0.05 * i for i in range(4)]
    images = [image(t, read_image(files / "frames" / f"{i}.png")) for i, t in enumerate(times)]
    places = [np.array([3.0, 3.0, z]) for z in HEIGHTS_MM[:4]]
    moves = [pose(t, place, DOWN) for t, place in zip(times, places, strict=True)]
    bag = write_bag(tmp_path / "bag", {"/gel": (IMAGE, images), "/pose": (POSE, moves)})
    done = tactorch("sensor", "unpack", f"bag={bag}", "out=session")
    assert done.status == 0, done.err
    assert "4 frames" in done.out
    poses(Path("poses.csv"))
    run = tmp_path / "run"
    direct = tactorch(*settings(files, calibration, run, "held_side=z-", "out=direct.h5"))
    assert direct.status == 0, direct.err
    again = settings(files, calibration, tmp_path / "other", "held_side=z-", "out=bag.h5")
    words = [
        word for word in again
        if not word.startswith(("frames=", "poses="))
    ]  # fmt: skip
    unpacked = tactorch(*words, "frames=session/frames", "poses=session/poses.csv")
    assert unpacked.status == 0, unpacked.err
    expected, found = Recording.load("direct.h5"), Recording.load("bag.h5")
    assert len(found.presses) == len(expected.presses)
    for one, other in zip(found.presses, expected.presses, strict=True):
        np.testing.assert_allclose(one.total_force, other.total_force, rtol=1e-3, atol=1e-6)
    assert SMALL[0] in words


def test_nothing_is_left_of_a_bag_that_is_refused(tactorch: Any, tmp_path: Path) -> None:
    black = np.zeros((4, 4, 3), np.uint8)
    images = [image(0.1, black), image(0.2, black[..., 0], "x")]
    moves = [pose(0.1 * i, np.zeros(3)) for i in range(5)]
    bag = write_bag(tmp_path / "bag", {"/gel": (IMAGE, images), "/pose": (POSE, moves)})
    done = tactorch("sensor", "unpack", f"bag={bag}", "out=session")
    assert done.status != 0
    assert "encoding 'x'" in done.err
    assert not list(Path().glob("*session*"))
    assert not list(Path().glob(".*session*"))
    Path("session").mkdir()
    done = tactorch("sensor", "unpack", f"bag={bag}", "out=session")
    assert "is there already" in done.err

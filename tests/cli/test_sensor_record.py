"""`tactorch sensor record`, on the drawn session of `test_sensor`."""

import gc
import json
import time
import weakref
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from tactorch.cli.sensor.inputs import FrameSequence
from tactorch.cli.sensor.options import SequenceSettings
from tactorch.recording import Recording
from tactorch.sensor import frames as sources
from tactorch.sensor.description import load_sensor

from .test_sensor import calibration, files, given, table

__all__ = ["calibration", "files"]  # fixtures
# The sensor looks down; its face comes from 0.2 mm above the box to 0.3 mm into its top.
HEIGHTS_MM = (4.2, 3.9, 3.8, 3.7, 4.2)
HEADER = "time_s,x_mm,y_mm,z_mm,qw,qx,qy,qz"
SMALL = (
    "edge_mm=1.2", "layers=3", "steps=2", "object.size_mm=[6,6,4]", "object.edge_mm=1",
    "contact_edge_mm=null",
)  # fmt: skip


def poses(
    path: Path,
    heights: tuple[float, ...] = HEIGHTS_MM,
    turn: str = "0,1,0,0",
    began_s: float = 0.0,
) -> Path:
    rows = [f"{began_s + 0.05 * i:.2f},3,3,{z},{turn}" for i, z in enumerate(heights)]
    path.write_text("\n".join([HEADER, *rows]) + "\n")
    return path


def settings(files: Path, calibration: Path, run: Path, *more: str) -> tuple[str, ...]:
    own = given(
        files,
        run,
        frames=files / "frames",
        calibration=calibration,
        poses="poses.csv",
    )
    return ("sensor", "record", *own, *SMALL, *more)


def test_a_session_becomes_a_recording(
    tactorch: Any, files: Path, calibration: Path, tmp_path: Path
) -> None:
    run, out = tmp_path / "run", tmp_path / "session.h5"
    poses(Path("poses.csv"))
    done = tactorch(*settings(files, calibration, run, "held_side=z-", f"out={out}"))
    assert done.status == 0, done.err
    recording = Recording.load(out)
    assert [press.name for press in recording.presses] == ["contact 1, 2.png", "contact 1, 3.png"]
    np.testing.assert_allclose(recording.mesh.bounds, [(0, 0, 0), (6, 6, 4)])
    light, hard = recording.presses
    assert 0 > light.total_force[2] > hard.total_force[2]  # down, into the box
    np.testing.assert_allclose(hard.direction, (0, 0, -1), atol=1e-9)
    assert hard.fixed[recording.mesh.points[:, 2] == 0].all()
    seen = hard.observed.all(axis=1)
    assert 3 <= seen.sum() <= 30  # the ball touches about the middle alone
    away = np.linalg.norm(recording.mesh.points[seen, :2] - 3.0, axis=1)
    assert away.max() < 2.5
    # The sensor went 0.3 mm in from where it met the box; under the ball the gel gave some of it.
    assert -0.3 < hard.displacement[seen, 2].min() < 0.1
    rows = table(run / "session.csv")
    assert [row["image"] for row in rows] == [f"{k}.png" for k in range(5)]
    assert [row["frame"] for row in rows] == [str(k) for k in range(5)]
    assert [row["selected"] for row in rows] == ["0", "0", "1", "1", "0"]
    assert [row["contact"] for row in rows] == ["", "1", "1", "1", ""]
    assert "cannot be read" in rows[4]["fault"]
    content = json.loads((run / "summary.json").read_text())
    assert content["contacts"] == 1
    assert [row["frame"] for row in content["presses"]] == ["2.png", "3.png"]
    assert recording.provenance["settings"]["held_side"] == "z-"
    assert recording.provenance["sensor"] == "drawn"
    for name in ("over_time.png", "presses.png", "summary.txt", ".hydra/config.yaml"):
        assert (run / name).is_file()


@pytest.mark.slow
def test_a_recording_grows_as_contacts_end(
    tactorch: Any, files: Path, calibration: Path, tmp_path: Path
) -> None:
    run, out = tmp_path / "run", tmp_path / "session.h5"
    poses(Path("poses.csv"))
    growing = settings(files, calibration, run, "held_side=z-", f"out={out}", "as_they_end=true")
    done = tactorch(*growing)
    assert done.status == 0, done.err
    recording = Recording.load(out)
    assert [press.name for press in recording.presses] == ["contact 1, 2.png", "contact 1, 3.png"]
    assert recording.provenance["sensor"] == "drawn"
    assert "contact 1: 2 presses up to" in done.out + done.err
    quick = (
        "max_presses=2",
        "plots=false",
        "shapes=false",
        "suggest.rule=none",
        f"run_dir={tmp_path / 'live'}",
    )
    followed = tactorch("live", f"recording={out}", *quick)
    assert followed.status == 0, followed.err
    assert (tmp_path / "live" / "reconstruction.h5").is_file()
    again = tactorch(*growing)
    assert again.status != 0
    assert "session.h5 is there already" in again.err
    assert len(Recording.load(out).presses) == 2


class DrawnCamera:
    """Gives the drawn frames, each 0.05 s after the one before, by a clock of its own."""

    began_unix_s = 1_800_000_000.0

    def __init__(self, folder: Path) -> None:
        self.files, self.now_s = iter(sorted(folder.iterdir())), 100.0

    def VideoCapture(self, number: int) -> "DrawnCamera":
        assert number == 0
        return self

    def isOpened(self) -> bool:
        return True

    def read(self) -> tuple[bool, np.ndarray | None]:
        file = next(self.files, None)
        image = None if file is None else cv2.imread(str(file))
        self.now_s += 0.05 if self.started else 0.0
        self.started = True
        return image is not None, image

    started = False

    def release(self) -> None:
        pass

    def sleep(self, seconds: float) -> None:
        time.sleep(seconds)

    def monotonic(self) -> float:
        return self.now_s

    def time(self) -> float:
        return self.began_unix_s + self.now_s - 100.0


@pytest.mark.slow
@pytest.mark.parametrize("as_they_end", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_a_camera_and_poses_by_unix_time(
    tactorch: Any, files: Path, calibration: Path, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch, as_they_end: bool,
) -> None:  # fmt: skip
    folder, taken = tmp_path / "folder", tmp_path / "camera"
    poses(Path("poses.csv"))
    more = ("held_side=z-", "plots=false", "steps=1")
    done = tactorch(*settings(files, calibration, folder, *more))
    assert done.status == 0, done.err
    drawn = DrawnCamera(files / "frames")
    poses(Path("poses.csv"), began_s=drawn.began_unix_s)
    monkeypatch.setattr(cv2, "VideoCapture", drawn.VideoCapture)
    monkeypatch.setattr(sources, "time", drawn)
    unix = ("frames=0", "max_frames=5", "poses_clock=unix", f"as_they_end={as_they_end}")
    done = tactorch(*settings(files, calibration, taken, *more, *unix))
    assert done.status == 0, done.err
    (one,) = Recording.load(folder / "recording.h5").presses
    (other,) = Recording.load(taken / "recording.h5").presses
    assert other.name == "contact 1, camera 0 frame 3"
    np.testing.assert_allclose(other.displacement, one.displacement, atol=1e-6)
    np.testing.assert_allclose(other.forces, one.forces, atol=1e-6)


@pytest.mark.slow
def test_an_object_of_unknown_shape(
    tactorch: Any, files: Path, calibration: Path, tmp_path: Path
) -> None:
    run = tmp_path / "run"
    poses(Path("poses.csv"))
    own = [one for one in SMALL if not one.startswith("object.")]
    cube = ("object=virtual_cube", "object.side_mm=4", "object.edge_mm=1", "plots=false", "steps=1")
    done = tactorch(*settings(files, calibration, run)[: -len(SMALL)], *own, *cube)
    assert done.status == 0, done.err
    recording = Recording.load(run / "recording.h5")
    low, high = recording.mesh.bounds
    np.testing.assert_allclose(high - low, 4.0, atol=1e-9)
    assert 3.8 < high[2] < 4.2 + 1e-9  # between the last frame without contact and the first
    (press,) = recording.presses
    top = np.isclose(recording.mesh.points[:, 2], high[2])
    assert press.observed[top].all()  # what is not touched moves with the sensor
    assert not (run / "presses.png").exists()


@pytest.mark.parametrize(
    ("turn", "heights", "more", "words"),
    [
        (
            "0,1,0,0",
            HEIGHTS_MM[:3],
            (),
            ("1 of 3 frames have no pose", "from 0.000 to 0.100 s"),
        ),
        ("0,0,0,0", HEIGHTS_MM, (), ("poses.csv", "quaternion has length 0")),
        ("1,0,0,0", HEIGHTS_MM, (), ("no frame with contact", "over no part of the object")),
        ("0,1,0,0", HEIGHTS_MM, ("poses=nowhere.csv",), ("table of poses", "nowhere.csv")),
        ("0,1,0,0", HEIGHTS_MM, ("min_slope=3",), ("shows contact", "deformed from 3 (min_slope)")),
        ("0,1,0,0", HEIGHTS_MM, ("steps=0",), ("steps=0: give a whole number, at least 1",)),
        ("0,1,0,0", HEIGHTS_MM, ("held_side=under",), ("side='under'", "opposite")),
        ("0,1,0,0", HEIGHTS_MM, ("held_by=glue",), ("'glue'", "springs")),
        ("0,1,0,0", HEIGHTS_MM, ("first_contact=feel",), ("'feel'", "shape or depth")),
        ("0,1,0,0", HEIGHTS_MM, ("poses_clock=sun",), ("poses_clock='sun'", "frames or unix")),
        ("0,1,0,0", HEIGHTS_MM, ("poses_clock=unix",), ("poses_clock=unix", "is no camera")),
        ("0,1,0,0", HEIGHTS_MM, ("untouched=gone",), ("untouched='gone'", "sensor")),
        ("0,1,0,0", HEIGHTS_MM, ("object.edge_mm=9",), ("object.edge_mm=9",)),
        ("0,1,0,0", HEIGHTS_MM, ("object=liver",), ("liver", "virtual_cube")),
        ("0,1,0,0", HEIGHTS_MM, ("object=mesh",), ("object.path",)),
        ("0,1,0,0", HEIGHTS_MM, ("object.size_mm=6",), ("object.size_mm=6", "[X,Y,Z]")),
    ],
)
def test_wrong_sessions(
    tactorch: Any,
    files: Path,
    calibration: Path,
    tmp_path: Path,
    turn: str,
    heights: tuple[float, ...],
    more: tuple[str, ...],
    words: tuple[str, ...],
) -> None:
    poses(Path("poses.csv"), heights, turn)
    run = tmp_path / "run"
    own = settings(files, calibration, run)
    if more and more[0].startswith("object="):
        own = own[: -len(SMALL)]
    done = tactorch(*own, *more)
    assert done.status == 2, done.out
    assert len(done.err.splitlines()) == 1, done.err
    assert all(word in done.err for word in words), done.err
    assert not list(run.glob("*.h5"))


def test_images_of_a_camera_are_not_stored(
    files: Path, calibration: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A session of a camera is read once; the images of earlier frames are freed."""
    drawn = DrawnCamera(files / "frames")
    monkeypatch.setattr(cv2, "VideoCapture", drawn.VideoCapture)
    monkeypatch.setattr(sources, "time", drawn)
    cfg = SequenceSettings(
        sensor=files / "sensor.yaml", frames=0, max_frames=4, reference=files / "still.png"
    )
    images: list[weakref.ref[np.ndarray]] = []
    for frame in FrameSequence(cfg, load_sensor(files / "sensor.yaml"), once=True):
        if frame.image is not None:
            images.append(weakref.ref(frame.image))
    assert len(images) == 4
    del frame
    gc.collect()
    assert not any(image() is not None for image in images[:-1])


@pytest.fixture
def unmarked(files: Path, tmp_path: Path) -> Path:
    """The sensor, as if its gel had no markers; those in the images are masked as dirt is."""
    content = yaml.safe_load((files / "sensor.yaml").read_text()) | {"markers": None}
    path = tmp_path / "unmarked.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


def test_depth_alone_is_recorded_and_told_as_such(
    tactorch: Any, files: Path, calibration: Path, unmarked: Path, tmp_path: Path
) -> None:
    run, out = tmp_path / "run", tmp_path / "session.h5"
    poses(Path("poses.csv"))
    own = settings(files, calibration, run, "held_side=z-", f"out={out}", f"sensor={unmarked}")
    done = tactorch(*own)
    assert done.status == 0, done.err
    recording = Recording.load(out)
    for press in recording.presses:
        assert not press.observed.any()
        assert press.surface is not None
        assert press.total_force[2] < 0.0
        np.testing.assert_allclose(press.total_force[:2], 0.0, atol=1e-9)
    assert recording.provenance["tangential_known"] is False
    assert "across its axis are unknown" in (run / "summary.txt").read_text()
    assert (run / "presses.png").is_file()


def test_unknown_forces_are_empty_in_tables(
    tactorch: Any, files: Path, calibration: Path, unmarked: Path, tmp_path: Path
) -> None:
    run = tmp_path / "run"
    own = given(files, run, frames=files / "frames", calibration=calibration, pictures=1)
    done = tactorch("sensor", "force", *own, f"sensor={unmarked}", "edge_mm=1.2", "layers=2",
                    "video=false")  # fmt: skip
    assert done.status == 0, done.err
    rows = table(run / "forces.csv")
    assert [row["image"] for row in rows] == [f"{k}.png" for k in range(5)]
    assert all(row["force_x_n"] == row["force_y_n"] == "" for row in rows[1:])
    assert float(rows[3]["force_z_n"]) < float(rows[1]["force_z_n"]) < 0.0
    text = (run / "summary.txt").read_text()
    assert "x unknown, y unknown, z -" in text
    assert "no markers" in text
    content = json.loads((run / "summary.json").read_text())
    assert content["tangential_known"] is False
    assert content["largest"]["image"] == "3.png"
    assert content["largest"]["force_on_gel_n"][:2] == [None, None]

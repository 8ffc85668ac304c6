"""`tactorch sensor`, on images drawn by the simulated sensor."""

import csv
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tactorch.sensor.calibration import (
    Ball,
    BallPress,
    Calibration,
    Circle,
    FitOptions,
    fit_map,
    image_change,
    load_calibration,
    marker_pixels,
    save_calibration,
)
from tactorch.sensor.description import GelLayer, MarkerGrid, SensorDescription, save_sensor
from tactorch.sensor.markers import MarkerAppearance
from tactorch.sensor.render import GelSurface, render

SENSOR = SensorDescription(
    "drawn", (150, 120), (0.08, 0.08), GelLayer(3.0, 0.15, 0.45, size_mm=(12.0, 9.6)),
    MarkerGrid(7, 5, (1.6, 1.7), 0.45), frame_rate_hz=20.0,
)  # fmt: skip
RADIUS_MM = 2.0
PRESSES = {
    f"press-{k}.png": (place, edge)
    for k, (place, edge) in enumerate(
        [
            ((75.0, 60.0), 13.0), ((50.0, 45.0), 12.0), ((100.0, 75.0), 12.0), ((98.0, 44.0), 13.0),
            ((52.0, 78.0), 13.0), ((70.0, 44.0), 12.0), ((84.0, 76.0), 13.0), ((60.0, 62.0), 12.0),
        ]
    )
}  # fmt: skip
CALIBRATE = (f"ball_radius_mm={RADIUS_MM}", "map=lookup", "rounds=1")
SHIFT_MM = (0.15, -0.1)


def still() -> GelSurface:
    return GelSurface(np.zeros(SENSOR.shape), SENSOR.to_px(SENSOR.markers.positions_mm))


def pressed(center: tuple[float, float], contact_px: float) -> GelSurface:
    """A press of the ball; beyond its contact the gel rises back."""
    rows, columns = np.indices(SENSOR.shape)
    away = np.hypot(columns - center[0], rows - center[1]) * 0.08
    edge = contact_px * 0.08
    rim = 0.35 * edge / np.sqrt(RADIUS_MM**2 - edge**2)
    ball = np.sqrt(RADIUS_MM**2 - edge**2) - np.sqrt(np.maximum(RADIUS_MM**2 - away**2, 0.0)) - rim
    height = np.where(away < edge, ball, -rim * np.exp(-(away - edge) / 0.35))
    return GelSurface(height, still().markers_px)


def write(path: Path, image: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), cv2.cvtColor(image, cv2.COLOR_RGB2BGR))


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sensor, its reference, presses of a ball, and a session of five frames, one damaged."""
    place = tmp_path_factory.mktemp("drawn")
    save_sensor(SENSOR, place / "sensor.yaml")
    write(place / "still.png", render(SENSOR, still(), seed=100))
    for seed, (name, (center, edge)) in enumerate(PRESSES.items()):
        write(place / "presses" / name, render(SENSOR, pressed(center, edge), seed=seed))
    for k, depth in enumerate((0.0, 8.0, 10.0, 13.0)):
        face = still() if depth == 0.0 else pressed((75.0, 60.0), depth)
        away = np.linalg.norm(face.markers_px - (75.0, 60.0), axis=1)
        near = np.exp(-((away / 60.0) ** 2))[:, None] * (depth / 13.0)
        moved = GelSurface(face.height_mm, face.markers_px + near * np.array(SHIFT_MM) / 0.08)
        write(place / "frames" / f"{k}.png", render(SENSOR, moved, seed=200 + k))
    (place / "frames" / "4.png").write_bytes(b"no image")
    return place


@pytest.fixture(scope="module")
def calibration(files: Path) -> Path:
    """A calibration from the presses, made without the command."""
    look, reference = MarkerAppearance(0.45 / 0.08), read(files / "still.png")
    touches = [
        BallPress(
            name,
            image_change(read(files / "presses" / name), reference, look),
            ~marker_pixels(read(files / "presses" / name), reference, look),
            Circle(center, edge),
        )
        for name, (center, edge) in PRESSES.items()
    ]
    ball = Ball(RADIUS_MM, (0.08, 0.08))
    found, _ = fit_map(touches, ball, FitOptions("lookup", rounds=0))
    save_calibration(Calibration(found, reference, ball.mm_per_px, look), files / "calib.npz")
    return files / "calib.npz"


def read(path: Path) -> np.ndarray:
    return cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB)


def table(path: Path) -> list[dict[str, str]]:
    with open(path, newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def given(files: Path, run: Path | str, **more: object) -> tuple[str, ...]:
    settings = {
        "sensor": files / "sensor.yaml",
        "reference": files / "still.png",
        "run_dir": run,
    }
    return tuple(f"{name}={value}" for name, value in {**settings, **more}.items())


def video_length(path: Path) -> int:
    capture, count = cv2.VideoCapture(str(path)), 0
    while capture.read()[0]:
        count += 1
    capture.release()
    return count


# ---------------------------------------------------------------- calibrate, check


def test_calibrate_finds_presses_and_tells_how_good_it_is(
    tactorch: Any, files: Path, tmp_path: Path
) -> None:
    run = tmp_path / "run"
    done = tactorch(
        "sensor",
        "calibrate",
        *given(files, run, images=files / "presses"),
        *CALIBRATE,
        "held_out=1",
    )
    assert done.status == 0, done.err
    assert {path.name for path in run.iterdir() if path.is_file()} == {
        "calib.npz", "quality.json", "quality.txt", "circles.csv", "held_out.png",
        "sensor-calibrate.log",
    }  # fmt: skip
    content = json.loads((run / "quality.json").read_text())
    assert len(content["presses"]) == 1
    assert content["evaluated"].endswith("fitted to 7 presses, on 1 others")
    assert content["held_out"] == list(content["presses"])
    assert content["fitted_to"].keys() == set(PRESSES)  # the calibration itself
    assert content["outlying"] == []
    assert min(content["quality"]["r2"]) > 0.9
    assert content["quality"]["depth_rms_mm"] < 0.05
    assert "lookup, fitted to 7 presses, on 1 others" in done.out
    for row in table(run / "circles.csv"):
        center, _ = PRESSES[row["image"]]
        off = np.subtract((float(row["center_x_px"]), float(row["center_y_px"])), center)
        assert np.linalg.norm(off) < 2.0
    facts = load_calibration(run / "calib.npz").facts
    assert facts["quality"] == content["quality"]
    assert facts["sensor"] == "drawn"


@pytest.mark.slow
def test_contacts_that_were_found_can_be_given_as_labels(
    tactorch: Any, files: Path, tmp_path: Path
) -> None:
    """Without rounds they are exact; each press is left out once."""
    labels, images = tmp_path / "labels.csv", tmp_path / "three"
    images.mkdir()
    for name in list(PRESSES)[:3]:
        shutil.copy(files / "presses" / name, images)
    rows = [f"{n},{c[0]},{c[1]},{e}" for n, (c, e) in list(PRESSES.items())[:2]]
    rows_text = "\n".join(["image,center_x_px,center_y_px,radius_px", *rows])
    labels.write_text(rows_text)
    settings = given(files, tmp_path / "run", images=images, labels=labels)
    out = tmp_path / "own.npz"
    done = tactorch(
        "sensor", "calibrate", *settings, *CALIBRATE[:2], "rounds=0", "folds=2", f"out={out}"
    )
    assert done.status == 0, done.err
    assert "2 contacts by labels, 1 found" in done.out
    content = json.loads((tmp_path / "run" / "quality.json").read_text())
    assert list(content["presses"]) != list(PRESSES)[:3]  # groups are dealt out
    assert content["presses"].keys() == set(list(PRESSES)[:3])
    assert "each left out once, in 2 groups" in content["evaluated"]
    labelled = [r for r in table(tmp_path / "run" / "circles.csv") if f"{r['image']}," in rows_text]
    assert len(labelled) == 2
    for row in labelled:
        center, edge = PRESSES[row["image"]]
        told_here = (row["center_x_px"], row["center_y_px"], row["radius_px"])
        assert tuple(map(float, told_here)) == (*center, edge)
    assert out.is_file()
    assert not (tmp_path / "run" / "calib.npz").exists()


@pytest.mark.slow
def test_check_judges_and_names_presses_that_were_learnt(
    tactorch: Any, files: Path, tmp_path: Path
) -> None:
    learnt, other = tmp_path / "learnt", tmp_path / "other"
    for k, name in enumerate(PRESSES):
        for folder in ([learnt] if k > 3 else []) + ([other] if k in (0, 4) else []):
            folder.mkdir(exist_ok=True)
            shutil.copy(files / "presses" / name, folder / name)
    run = tmp_path / "run"
    done = tactorch(
        "sensor", "calibrate", *given(files, run, images=learnt), *CALIBRATE, "held_out=0"
    )
    assert done.status == 0, done.err
    assert "on the 4 presses it was fitted to: others do worse" in done.out
    settings = given(files, tmp_path / "check", images=other, calibration=run / "calib.npz")
    done = tactorch("sensor", "check", *settings, f"ball_radius_mm={RADIUS_MM}")
    assert done.status == 0, done.err
    content = json.loads((tmp_path / "check" / "quality.json").read_text())
    assert content["presses"].keys() == {"press-0.png", "press-4.png"}
    assert min(content["quality"]["r2"]) > 0.9
    assert content["fitted_to"] == ["press-4.png"]
    assert "was fitted to 1 of these presses (press-4.png)" in done.out


@pytest.mark.slow
def test_map_is_chosen_by_presses_left_out(tactorch: Any, files: Path, tmp_path: Path) -> None:
    settings = given(files, tmp_path / "run", images=files / "presses")
    done = tactorch("sensor", "calibrate", *settings, CALIBRATE[0], "rounds=1")
    assert done.status == 0, done.err
    facts = load_calibration(tmp_path / "run" / "calib.npz").facts
    assert facts["maps"].keys() == {"mlp", "mlp_colour", "lookup"}
    scores = {n: sum(facts["maps"][n]["mae"]) for n in facts["maps"]}
    scores["mlp_colour"] *= 0.95  # the others, which use the position, gain 5 %
    assert facts["fit"]["map"]["name"] == min(scores, key=lambda n: scores[n])


# ---------------------------------------------------------------- frames


@pytest.mark.slow
def test_track_tells_displacements_and_what_is_faulty(
    tactorch: Any, files: Path, tmp_path: Path
) -> None:
    run = tmp_path / "run"
    settings = given(files, run, frames=files / "frames", pictures=2)
    done = tactorch("sensor", "track", *settings, "backward=true")
    assert done.status == 0, done.err
    assert {path.name for path in run.iterdir() if path.is_file()} == {
        "tracks.csv", "tracks.npz", "summary.json", "summary.txt", "over_time.png", "markers.mp4",
        "markers-0000.png", "markers-0004.png", "sensor-track.log",
    }  # fmt: skip
    assert video_length(run / "markers.mp4") == 5
    rows = table(run / "tracks.csv")
    assert len(rows) == 5 * 35
    arrays = np.load(run / "tracks.npz")
    begin = arrays["begin_px"]
    away = np.linalg.norm(begin - (75.0, 60.0), axis=1)
    true = np.exp(-((away / 60.0) ** 2))[:, None] * np.array(SHIFT_MM)
    off = np.linalg.norm(arrays["displacement_mm"][3] - true, axis=1)
    assert np.nanmedian(off) < 0.1 * 0.08  # a tenth of a pixel
    assert arrays["valid"][3].mean() > 0.9
    assert not arrays["valid"][4].any()
    last = rows[-1]
    assert (last["frame"], last["valid"], last["dx_mm"]) == ("4", "0", "")
    assert "cannot be read" in last["fault"]
    for row, place in zip(rows, begin, strict=False):  # the first frame
        moved = float(row["dx_mm"]) / 0.08
        assert float(row["x_px"]) == pytest.approx(place[0] + moved, abs=1e-3)
    content = json.loads((run / "summary.json").read_text())
    assert [one["frame"] for one in content["faulty"]] == [4]
    assert content["backward"]["markers"] >= 30
    assert content["backward"]["under_half_px"] == 1.0
    assert "1 of 5 frames are faulty" in done.out


def test_reconstruct_tells_depth(
    tactorch: Any, files: Path, calibration: Path, tmp_path: Path
) -> None:
    run = tmp_path / "run"
    settings = given(files, run, frames=files / "frames", calibration=calibration, pictures=1)
    done = tactorch("sensor", "reconstruct", *settings, "video=false")
    assert done.status == 0, done.err
    assert [path.name for path in sorted((run / "heights").iterdir())] == [
        f"0000{k}.npz" for k in range(4)
    ]
    depth = [float(row["depth_mm"] or "nan") for row in table(run / "depth.csv")]
    assert depth[1] < depth[2] < depth[3]
    assert np.isnan(depth[4])
    with np.load(run / "heights" / "00003.npz") as found:
        height, contact = found["height_mm"], found["contact"]
    true = pressed((75.0, 60.0), 13.0).height_mm
    assert contact[60, 75]
    assert not contact[:20].any()
    inside = np.hypot(*(np.indices(SENSOR.shape) - np.array([60, 75])[:, None, None])) < 11
    assert np.std((height - true)[inside]) < 0.05
    assert depth[3] == pytest.approx(-height.min(), rel=1e-4)
    assert {path.name for path in run.glob("depth*")} == {"depth.csv", "depth-0000.png"}


@pytest.mark.slow
def test_force_is_told_of_each_frame(
    tactorch: Any, files: Path, calibration: Path, tmp_path: Path
) -> None:
    run = tmp_path / "run"
    settings = given(files, run, frames=files / "frames", calibration=calibration, pictures=1)
    coarse = ("edge_mm=0.8", "layers=2", "element=tet4", "video=false")
    done = tactorch("sensor", "force", *settings, *coarse)
    assert done.status == 0, done.err
    rows = table(run / "forces.csv")
    z = [float(row["force_z_n"] or "nan") for row in rows]
    assert z[3] < z[2] < z[1] < 0.0  # the ball pushes the gel into the sensor, deeper with more
    assert abs(z[0]) < 0.02
    assert np.isnan(z[4])
    assert rows[4]["contact_mm2"] == ""
    assert "cannot be read" in rows[4]["fault"]
    assert float(rows[3]["force_x_n"]) > 0.0  # as the markers went
    assert float(rows[3]["force_y_n"]) < 0.0
    with np.load(run / "forces.npz") as found:
        assert found["forces_n"][3, :, 2].sum() == pytest.approx(z[3], rel=1e-4)
        assert found["forces_n"].shape == (5, *found["points_mm"].shape)
        assert found["triangles"].max() == len(found["points_mm"]) - 1
        assert not found["forces_n"][3][~found["touched"][3]].any()
    assert not (run / "force.mp4").exists()
    assert (run / "force-0000.png").is_file()


@pytest.mark.slow
def test_ctrl_c_leaves_nothing_half_written(
    tactorch: Any, files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from tactorch.viz.sensor_frames import MarkerView

    shown: list[str] = []
    show = MarkerView.show

    def stopped(view: MarkerView, image: Any, places: Any, caption: str) -> None:
        shown.append(caption)
        if len(shown) == 3:
            raise KeyboardInterrupt
        show(view, image, places, caption)

    run = tmp_path / "run"
    settings = given(files, run, frames=files / "frames")
    run.mkdir()
    for name in ("markers.mp4", "over_time.png", "tracks.csv"):
        (run / name).write_text("of an earlier run")
    monkeypatch.setattr(MarkerView, "show", stopped)
    done = tactorch("sensor", "track", *settings)
    assert done.status == 130
    assert "interrupted" in done.err
    names = {path.name for path in run.iterdir()}
    assert not {name for name in names if ".part" in name}
    assert not {"markers.mp4", "over_time.png"} & names
    assert len(table(run / "tracks.csv")) == 5 * 35  # was whole by then


def test_a_camera_is_a_number(tactorch: Any, files: Path, tmp_path: Path) -> None:
    settings = given(files, tmp_path / "run", frames=0)
    done = tactorch("sensor", "track", *settings)
    assert "camera; give max_frames" in done.err
    done = tactorch("sensor", "track", *given(files, tmp_path / "run", frames=98, max_frames=2))
    assert "camera 98 cannot be opened" in done.err


# ---------------------------------------------------------------- wrong input

Spoil = Callable[[Path], object]


def no_ball(folder: Path) -> None:
    write(folder / "presses" / "flat.png", render(SENSOR, still(), seed=7))


def small(folder: Path) -> None:
    for path in (folder / "presses").iterdir():
        write(path, read(path)[:50])


def labels(text: str) -> Spoil:
    return lambda folder: (folder / "labels.csv").write_text(text)


HEADER = "image,center_x_px,center_y_px,radius_px\n"
ONE = HEADER + "press-0.png,75,60,13\n"


@pytest.mark.parametrize(
    ("spoil", "settings", "words"),
    [
        (no_ball, (), ("flat.png: no ball found",)),
        (small, (), ("hold no press of the ball", "presses")),
        (None, ("images=nowhere",), ("folder of frames not found: 'nowhere'",)),
        (None, ("reference=nowhere.png",), ("nowhere.png",)),
        (None, ("reference_frames=0",), ("reference_frames=0: give a whole number, at least 1",)),
        (None, ("sensor=mini",), ("'mini'", "gelsight_mini")),
        (None, ("ball_radius_mm=0.01",), ("radius_mm=0.01", "0.2 to 100")),
        (None, ("ball_radius_mm=big",), ("ball_radius_mm='big'", "a number")),
        (None, ("ball_radius_mm=0.5", "labels=labels.csv"), ("press-0.png", "wider than the ball")),
        (None, ("mm_per_px=0.08",), ("mm_per_px=0.08", "[X,Y]")),
        (None, ("mm_per_px=[12.5,12.5]",), ("mm_per_px", "pixels per mm")),
        (None, ("labels=nowhere.csv",), ("nowhere.csv",)),
        (labels(HEADER + "other.png,1,2,9\n"), ("labels=labels.csv",), ("'other.png'", "not hold")),
        (labels("image,x\na,1\n"), ("labels=labels.csv",), ("labels.csv", "lacks", "center_x_px")),
        (None, ("map=cnn",), ("map='cnn'", "auto, mlp")),
        (None, ("held_out=8",), ("held_out=8 of 8", "leaves none")),
        (None, ("folds=9",), ("folds=9", "8 presses")),
        (None, ("folds=2", "held_out=2"), ("held_out or folds",)),
        (None, ("rounds=-1",), ("rounds=-1",)),
    ],
)
def test_wrong_settings_of_calibrate(
    tactorch: Any,
    files: Path,
    tmp_path: Path,
    spoil: Spoil | None,
    settings: tuple[str, ...],
    words: tuple[str, ...],
) -> None:
    shutil.copytree(files / "presses", "presses")
    labels(ONE)(Path())
    if spoil is not None:
        spoil(Path())
    run = tmp_path / "run"
    done = tactorch(
        "sensor", "calibrate", *given(files, run, images="presses"), *CALIBRATE, *settings
    )
    assert done.status == 2, done.out
    assert done.err.startswith("tactorch sensor calibrate: error: ")
    assert len(done.err.splitlines()) == 1
    assert all(word in done.err for word in words), done.err
    assert not list(run.glob("*.npz"))


def wide(folder: Path) -> None:
    found = load_calibration(folder / "calib.npz")
    other = Calibration(found.map, found.reference[:, :100].copy(), found.mm_per_px)
    save_calibration(other, folder / "calib.npz")


def resized(folder: Path) -> None:
    for k in range(2):
        write(folder / f"resized/{k}.png", np.full((60, 75, 3), 120, dtype=np.uint8))


@pytest.mark.parametrize(
    ("verb", "spoil", "settings", "words"),
    [
        ("track", resized, ("frames=resized",), ("no frame can be used", "0.png is 75 x 60 px")),
        ("track", None, ("frames=nowhere",), ("folder of frames not found: 'nowhere'",)),
        ("track", None, ("frames=calib.npz",), ("calib.npz", "no source of frames")),
        ("track", None, ("magnify=0",), ("magnify=0",)),
        ("track", None, ("pictures=-1",), ("pictures=-1",)),
        ("track", None, ("max_frames=0",), ("max_frames=0",)),
        ("track", None, ("marker_diameter_px=60",), ("1 markers were found in the reference",)),
        ("force", None, ("calibration=nowhere.npz",), ("calibration not found", "nowhere.npz")),
        ("force", wide, (), ("calib.npz", "100 x 120 px", "150 x 120")),
        ("force", None, ("noise_mm=0",), ("noise_mm=0",)),
        ("force", None, ("edge_mm=9",), ("edge_mm=9",)),
        ("reconstruct", wide, (), ("calib.npz", "100 x 120 px")),
        ("reconstruct", None, ("min_depth_mm=0",), ("min_depth_mm=0",)),
    ],
)
def test_wrong_settings_of_frames(
    tactorch: Any,
    files: Path,
    calibration: Path,
    tmp_path: Path,
    verb: str,
    spoil: Spoil | None,
    settings: tuple[str, ...],
    words: tuple[str, ...],
) -> None:
    shutil.copy(calibration, "calib.npz")
    if spoil is not None:
        spoil(Path())
    own = () if verb == "track" else ("calibration=calib.npz",)
    run = tmp_path / "run"
    done = tactorch("sensor", verb, *given(files, run, frames=files / "frames"), *own, *settings)
    assert done.status == 2, done.out
    assert done.err.startswith(f"tactorch sensor {verb}: error: ")
    assert len(done.err.splitlines()) == 1
    assert all(word in done.err for word in words), done.err
    assert not [p for p in run.glob("*") if p.suffix not in (".log", "") and p.name != ".hydra"]


def test_track_needs_markers(tactorch: Any, files: Path, tmp_path: Path) -> None:
    from dataclasses import replace

    save_sensor(replace(SENSOR, markers=None), tmp_path / "bare.yaml")
    settings = given(
        files,
        tmp_path / "run",
        frames=files / "frames",
        sensor=tmp_path / "bare.yaml",
    )
    done = tactorch("sensor", "track", *settings)
    assert done.status == 2
    assert "has no markers" in done.err
    done = tactorch(
        "sensor", "track", *settings, "marker_diameter_px=5.6", "video=false", "pictures=0"
    )
    assert done.status == 0, done.err


# ---------------------------------------------------------------- real images


@pytest.mark.external
@pytest.mark.slow
def test_real_presses_of_a_ball(tactorch: Any, shared_data: Path, tmp_path: Path) -> None:
    """18 presses fit, 6 are held out."""
    bare = SensorDescription(
        "bare", (240, 320), (1 / 19.58, 1 / 19.58), GelLayer(4.0, 0.435, size_mm=(12.2, 16.3))
    )
    save_sensor(bare, tmp_path / "bare.yaml")
    data, run = shared_data / "fots-mini", tmp_path / "run"
    done = tactorch(
        "sensor", "calibrate", f"sensor={tmp_path / 'bare.yaml'}", f"images={data / 'gelsight'}",
        f"reference={data / 'bg/gelsight_bg.png'}", "ball_radius_mm=2.35", "map=mlp",
        "held_out=6", f"run_dir={run}",
    )  # fmt: skip
    assert done.status == 0, done.err
    content = json.loads((run / "quality.json").read_text())
    assert min(content["quality"]["r2"]) > 0.95
    assert content["quality"]["depth_rms_mm"] < 0.05


@pytest.mark.external
@pytest.mark.slow
def test_real_video_of_markers(tactorch: Any, shared_data: Path, tmp_path: Path) -> None:
    """Its scale is not published; the first eleven frames are without contact."""
    own = SensorDescription(
        "video", (960, 720), (0.0262, 0.0262), GelLayer(2.5, 0.2, size_mm=(25.2, 18.9)),
        MarkerGrid(14, 9, (1.73, 1.73), 0.47), frame_rate_hz=30.0,
    )  # fmt: skip
    save_sensor(own, tmp_path / "own.yaml")
    video, run = shared_data / "bnz-ball-markers/track_markers/video.avi", tmp_path / "run"
    done = tactorch(
        "sensor", "track", f"sensor={tmp_path / 'own.yaml'}", f"frames={video}",
        f"reference={video}", "reference_frames=11", "backward=true", f"run_dir={run}",
    )  # fmt: skip
    assert done.status == 0, done.err
    content = json.loads((run / "summary.json").read_text())
    assert content["frames"] == 48
    assert content["seen_in_all_readable_frames"] >= 118
    assert content["backward"]["under_half_px"] > 0.97
    assert video_length(run / "markers.mp4") == 48


# ---------------------------------------------------------------- differentiable camera


@pytest.mark.slow
def test_heights_are_fitted_to_the_images(tactorch: Any, files: Path, tmp_path: Path) -> None:
    run, out = tmp_path / "run", tmp_path / "calib.npz"
    images = given(files, run, images=files / "presses")
    done = tactorch(
        "sensor", "calibrate", *images, *CALIBRATE, "held_out=0", "camera=true", f"out={out}"
    )
    assert done.status == 0, done.err
    assert "camera: rendered colours differ by" in done.out
    light = load_calibration(out).light
    assert light is not None
    assert 50.0 * light.deviation < 10.0  # gray values
    settings = given(files, tmp_path / "depth", frames=files / "frames", calibration=out)
    quick = ("pictures=0", "video=false")
    done = tactorch("sensor", "reconstruct", *settings, *quick, "depth=fit")
    assert done.status == 0, done.err
    rows = table(tmp_path / "depth" / "depth.csv")
    true_mm = -pressed((75.0, 60.0), 13.0).height_mm.min()
    assert float(rows[3]["depth_mm"]) == pytest.approx(true_mm, rel=0.25)


def test_a_calibration_without_light_cannot_fit(
    tactorch: Any, files: Path, calibration: Path, tmp_path: Path
) -> None:
    settings = given(files, tmp_path / "run", frames=files / "frames", calibration=calibration)
    done = tactorch("sensor", "reconstruct", *settings, "depth=fit", "pictures=0", "video=false")
    assert done.status != 0
    assert "calibrate again with camera=true" in done.err

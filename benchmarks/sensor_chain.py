"""From camera images to a map of Young's modulus, without inverse crime (Section VI).

    python benchmarks/sensor_chain.py [--session NAME...] [--rim 0.4] [--keep FOLDER] [--out FOLDER]

A cube of 10 mm with a ball is pressed on three sides, to two depths each, by a gel of 16 mm that is
wider than it. Gel and cube are one body of quadratic elements, refined at the edge of the contact,
see `sensor_truth.py`. The gel's face is rendered, and drawn as a camera with a distorting lens sees
it, with noise and 8 bits. The further input is images, poses and the descriptions of sensor and
object only, by the commands of tactorch:

    tactorch sensor calibrate   from drawn presses of a ball
    tactorch sensor record      markers, depth, forces, presses on a mesh of the cube
    tactorch invert             inclusions

The error of each stage is relative to the simulation. Sessions differ in the ball, the place of the
sensor, the depths and the seed of the noise. In `faults` the poses of each contact are off by
0.2 mm and 0.5 degrees, the gel is 5 % stiffer than stated, and the light drifts by 6 %; stated are
standard deviations of 0.2 mm, 0.5 degrees and 10 %. The last line printed is one JSON object.
"""

import argparse
import csv
import json
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
from machine import OtherWork, write_results
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial.transform import Rotation
from sensor_truth import Ball, Contact, PressedBox, press_box

from tactorch.inverse import Reconstruction
from tactorch.inverse.result.shapes import ShapeInclusion
from tactorch.recording import Press, Recording
from tactorch.sensor.calibration import Calibration, load_calibration
from tactorch.sensor.chain import ChainOptions, SensorChain
from tactorch.sensor.description import GelLayer, MarkerGrid, SensorDescription, save_sensor
from tactorch.sensor.frames import Image, read_frames
from tactorch.sensor.gel import GelModel
from tactorch.sensor.markers import marker_displacements
from tactorch.sensor.render import GelSurface, RenderOptions, build_surface, render

PACKAGES = ("tactorch", "torch", "numpy", "scipy", "opencv-python-headless", "pypardiso", "mkl")
SIDE, POISSON = 10.0, 0.45
# A wide, flat contact has small slopes; without contact they are below a third of this.
MIN_SLOPE = 0.03
APART = 0.4  # mm, of gel and cube before and after
FRAME_RATE_HZ = 10.0
NOISE = 1.5  # of the camera, gray values
GEL = GelLayer(4.0, 0.12, POISSON, size_mm=(16.0, 16.0))
SENSOR = SensorDescription(
    "simulated", (320, 320), (0.05, 0.05), GEL, MarkerGrid(13, 13, (1.2, 1.2), 0.45),
    frame_rate_hz=FRAME_RATE_HZ, raw_size_px=(400, 380), intrinsics_px=(520.0, 520.0, 199.0, 188.0),
    distortion=(-0.18, 0.05, 0.001, -0.0015),
    warp_corners_px=((42.0, 31.0), (357.0, 34.0), (354.0, 349.0), (39.0, 346.0)),
)  # fmt: skip
# Turns of the cube that bring a side up.
SIDES = {
    "z+": np.eye(3),
    "x+": np.array([(0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)]),
    "y+": np.array([(0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)]),
}
MIDDLE = np.full(3, SIDE / 2)
WAYS = {"map": "with the object", "by_forces": "of the gel"}
#: Pose of a sensor whose z axis points down: x along y, y along x.
DOWN = np.array([(0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, -1.0)])


@dataclass(frozen=True)
class Session:
    """Object and presses of a session on a cube.

    Attributes:
        ball: Inclusion.
        youngs_mpa: Young's modulus around it, MPa.
        offset_mm: Of the sensor's axis from the middle of a side.
        depths_mm: How far the window is moved from first touch.
        seed: Of the noise of the camera.
        faults: Whether poses, gel and light are not as stated.
    """

    ball: Ball
    youngs_mpa: float = 0.2
    offset_mm: tuple[float, float] = (0.0, 0.0)
    depths_mm: tuple[float, float] = (0.5, 1.0)
    seed: int = 0
    faults: bool = False


SESSIONS = {
    "main": Session(Ball((6.0, 4.4, 6.6), 2.0, 1.0)),
    "shifted": Session(Ball((4.2, 5.6, 6.2), 1.8, 0.8), 0.2, (0.6, -0.4), (0.6, 1.2), 1),
    "soft": Session(Ball((5.5, 5.8, 6.3), 2.2, 0.07), 0.25, (-0.5, 0.3), (0.5, 1.0), 2),
    "small": Session(Ball((6.2, 6.0, 6.8), 1.5, 1.0), 0.15, (0.2, 0.7), (0.4, 0.9), 3),
    "central": Session(Ball((5.0, 5.0, 5.4), 2.2, 0.9), 0.3, (-0.3, -0.8), (0.5, 1.1), 4),
    "faults": Session(Ball((6.0, 4.4, 6.6), 2.0, 1.0), seed=5, faults=True),
}
AGED, DRIFT = 1.05, 0.06  # modulus of the gel over the stated one, and change of the light
OFF_MM, OFF_DEG = 0.2, 0.5  # of poses
STATED = f"pose_mm={OFF_MM}", f"pose_deg={OFF_DEG}", "gel_deviation=0.1"


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the chain and print the tables and the JSON line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--session", nargs="+", default=["main"], choices=[*SESSIONS, "all"])
    parser.add_argument("--rim", type=float, default=0.4, help="edges at the contact's edge, mm")
    parser.add_argument("--keep", type=Path, help="folder for images and runs")
    parser.add_argument("--out", type=Path, help="folder for sensor_chain.json and .md")
    options = parser.parse_args(arguments)
    meter = OtherWork()
    names = list(SESSIONS) if "all" in options.session else options.session
    with TemporaryDirectory() as temporary:
        place = options.keep or Path(temporary)
        results = {name: run(SESSIONS[name], place / name, options.rim) for name in names}
    lines = format_tables(results)
    print("\n".join(lines))
    print(f"Other processes took {meter.share() or 0:.0%} of the cores meanwhile.\n")
    if options.out is not None:
        write_results(options.out, "sensor_chain", lines, results, PACKAGES)
    print(json.dumps(results))


def run(session: Session, place: Path, rim_mm: float) -> dict[str, Any]:
    """Simulate a session, run the commands, and return the errors of all stages."""
    contacts = {name: simulated(session, turn, rim_mm) for name, turn in SIDES.items()}
    draw_session(place, session, contacts)
    quality = calibrated(place)
    presses = recorded(place, session)
    chain = Stages(place, session)
    rows = [
        {"side": name, "depth_mm": depth, **chain.errors(contact, session, depth),
         **on_object(presses[(name, depth)], contact, turn)}
        for name, turn in SIDES.items()
        for depth, contact in zip(session.depths_mm, contacts[name], strict=True)
    ]  # fmt: skip
    by_forces = inverted(place, session, gels=False)
    return {
        "calibration": quality, "presses": rows, "map": inverted(place, session),
        "by_forces": by_forces,
    }  # fmt: skip


def simulated(session: Session, turn: np.ndarray, rim_mm: float) -> list[Contact]:
    """Press the gel on the cube, turned so that a side is up."""
    center = turn @ (session.ball.center_mm - MIDDLE) + MIDDLE
    ball = Ball(tuple(center.tolist()), session.ball.radius_mm, session.ball.youngs_mpa)
    gel = replace(GEL, youngs_mpa=AGED * GEL.youngs_mpa) if session.faults else GEL
    box = PressedBox(SIDE, session.youngs_mpa, POISSON, ball, gel, session.offset_mm)
    return press_box(box, [np.array([0.0, 0.0, -depth]) for depth in session.depths_mm], rim_mm)


def looking_down(session: Session, z_mm: float) -> np.ndarray:
    """Pose of the sensor over the cube."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = DOWN, (*(SIDE / 2 + np.array(session.offset_mm)), z_mm)
    return pose


def gel_face(contact: Contact, session: Session, depth: float) -> tuple[np.ndarray, np.ndarray]:
    """Points of the gel's face at rest and their displacement against the window, sensor frame."""
    origin = looking_down(session, SIDE)[:3, 3]
    return (contact.points - origin) @ DOWN, (contact.moved + np.array([0.0, 0.0, depth])) @ DOWN


def draw_calibration(place: Path, first: int, sensor: SensorDescription = SENSOR) -> None:
    """Write the description, an image without contact and presses of a ball; seeds from `first`."""
    for name in ("balls", "frames"):
        (place / name).mkdir(parents=True, exist_ok=True)
    save_sensor(sensor, place / "sensor.yaml")
    save_image(still(first + 1000, sensor), place / "still.png")
    rng = np.random.default_rng(first + 3)
    for i in range(14):
        center = 70.0 + rng.uniform(0.0, 1.0, 2) * (np.array(sensor.image_size_px) - 140.0)
        image = ball_image(center, float(rng.uniform(32, 44)), first + 2000 + i, sensor)
        save_image(image, place / "balls" / f"{i:02d}.png")


def draw_session(place: Path, session: Session, contacts: dict[str, list[Contact]]) -> None:
    """Write what a user has: description, presses of a ball, frames of the session, poses."""
    first = 10_000 * session.seed
    draw_calibration(place, first)
    poses = list[np.ndarray]()
    rng = np.random.default_rng(first + 4)
    for name, turn in SIDES.items():
        pairs = list(zip(session.depths_mm, contacts[name], strict=True))
        off = misplacement(rng) if session.faults else np.eye(4)
        for pair in (None, None, *pairs, None):
            number = len(poses)
            light = 1.0 + session.faults * DRIFT * number / (len(SIDES) * (len(pairs) + 3) - 1)
            if pair is None:
                image, depth = still(first + number, light=light), -APART
            else:
                depth = pair[0]
                face = build_surface(SENSOR, *gel_face(pair[1], session, depth))
                image = photographed(face, first + number, light=light)
            save_image(image, place / "frames" / f"{number:03d}.png")
            poses.append(pose_of(session, turn, depth) @ off)
    write_poses(place, poses)


def misplacement(rng: np.random.Generator) -> np.ndarray:
    """Draw an error of the pose of a contact: position and rotation in random directions."""
    move, axis = (one / np.linalg.norm(one) for one in rng.standard_normal((2, 3)))
    off = np.eye(4)
    off[:3, :3] = Rotation.from_rotvec(np.deg2rad(OFF_DEG) * axis).as_matrix()
    off[:3, 3] = OFF_MM * move
    return off


def write_poses(place: Path, poses: Sequence[np.ndarray]) -> None:
    """Write the pose of the sensor in each frame."""
    with open(place / "poses.csv", "w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(["time_s", "x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz"])
        for number, pose in enumerate(poses):
            turn = Rotation.from_matrix(pose[:3, :3]).as_quat(scalar_first=True)
            values = number / FRAME_RATE_HZ, *pose[:3, 3], *turn
            table.writerow([f"{value:.9g}" for value in values])


def pose_of(session: Session, turn: np.ndarray, depth: float) -> np.ndarray:
    """Pose of the sensor in the cube's frame."""
    back = np.eye(4)
    back[:3, :3], back[:3, 3] = turn.T, MIDDLE - turn.T @ MIDDLE
    return back @ looking_down(session, SIDE - depth)


def save_image(image: Image, path: Path) -> None:
    """Write an RGB image."""
    cv2.imwrite(str(path), image[..., ::-1])


def photographed(
    face: GelSurface, seed: int, sensor: SensorDescription = SENSOR, light: float = 1.0
) -> Image:
    """Draw what the camera sees of a face: through the lens, with noise and 8 bits."""
    ideal = render(sensor, face, RenderOptions(noise=0.0)).astype(np.float32)
    columns, rows = lens_map(sensor)
    seen = cv2.remap(ideal, columns, rows, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    noisy = light * seen + np.random.default_rng(seed).normal(0.0, NOISE, seen.shape)
    return np.clip(noisy.round(), 0, 255).astype(np.uint8)


def lens_map(sensor: SensorDescription = SENSOR) -> tuple[np.ndarray, np.ndarray]:
    """Position in the rectified image of each pixel of a raw one."""
    width, height = sensor.raw_size_px
    fx, fy, cx, cy = sensor.intrinsics_px
    matrix = np.array([(fx, 0.0, cx), (0.0, fy, cy), (0.0, 0.0, 1.0)])
    rows, columns = np.indices((height, width), dtype=np.float64)
    raw = np.stack([columns, rows], axis=-1).reshape(-1, 1, 2)
    straight = cv2.undistortPoints(raw, matrix, np.array(sensor.distortion), P=matrix)
    w, h = sensor.image_size_px
    targets = np.array([(0, 0), (w - 1, 0), (w - 1, h - 1), (0, h - 1)], np.float32)
    warp = cv2.getPerspectiveTransform(np.array(sensor.warp_corners_px, np.float32), targets)
    found = cv2.perspectiveTransform(straight, warp).reshape(height, width, 2)
    return found[..., 0].astype(np.float32), found[..., 1].astype(np.float32)


def still(seed: int, sensor: SensorDescription = SENSOR, light: float = 1.0) -> Image:
    """Draw the gel without contact."""
    flat = GelSurface(np.zeros(sensor.shape), sensor.to_px(sensor.markers.positions_mm))
    return photographed(flat, seed, sensor, light)


def ball_image(
    center: np.ndarray, contact_px: float, seed: int, sensor: SensorDescription = SENSOR
) -> Image:
    """Draw a press of the ball; beyond its contact the gel rises back."""
    rows, columns = np.indices(sensor.shape)
    away = np.hypot(columns - center[0], rows - center[1]) * 0.05
    edge = contact_px * 0.05
    rim = 0.35 * edge / np.sqrt(9.0 - edge**2)
    inner = np.sqrt(9.0 - edge**2) - np.sqrt(np.maximum(9.0 - away**2, 0.0)) - rim
    height = np.where(away < edge, inner, -rim * np.exp(-(away - edge) / 0.35))
    markers = sensor.to_px(sensor.markers.positions_mm)
    return photographed(GelSurface(height, markers), seed, sensor)


def tactorch(*arguments: str) -> None:
    """Run a command as a user does."""
    done = subprocess.run(
        [sys.executable, "-m", "tactorch", *arguments, "overwrite=true"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    if done.returncode:
        raise SystemExit(f"tactorch {' '.join(arguments)}:\n{done.stdout}\n{done.stderr}")


def calibrated(place: Path) -> dict[str, Any]:
    """Calibrate with the presses of the ball, three of them held out."""
    tactorch(
        "sensor", "calibrate", f"sensor={place}/sensor.yaml", f"images={place}/balls",
        f"reference={place}/still.png", "ball_radius_mm=3", "map=mlp", "rounds=3", "held_out=3",
        f"out={place}/calib.npz", f"run_dir={place}/calibrate",
    )  # fmt: skip
    quality = json.loads((place / "calibrate" / "quality.json").read_text())["quality"]
    assert isinstance(quality, dict)
    return quality


def recorded(place: Path, session: Session) -> dict[tuple[str, float], Press]:
    """Record the session; presses by side and depth, in the order in which they were drawn."""
    tactorch(
        "sensor", "record", f"sensor={place}/sensor.yaml", f"calibration={place}/calib.npz",
        f"frames={place}/frames", f"poses={place}/poses.csv", f"reference={place}/still.png",
        f"object.size_mm=[{SIDE},{SIDE},{SIDE}]", "object.edge_mm=1.25",
        f"steps={len(session.depths_mm)}", f"min_slope={MIN_SLOPE}", f"out={place}/recording.h5",
        f"run_dir={place}/record", *(STATED if session.faults else ()),
    )  # fmt: skip
    presses = Recording.load(place / "recording.h5").presses
    wanted = [(name, depth) for name in SIDES for depth in session.depths_mm]
    if len(presses) != len(wanted):
        raise SystemExit(f"{len(presses)} presses were recorded, not {len(wanted)}.")
    return dict(zip(wanted, presses, strict=True))


class Stages:
    """Results and errors of each stage for a frame."""

    def __init__(self, place: Path, session: Session) -> None:
        self.calibration: Calibration = load_calibration(place / "calib.npz")
        self.model = GelModel(GEL)
        reference = self.calibration.reference
        self.chain = SensorChain(
            SENSOR, self.calibration, reference, self.model,
            ChainOptions(min_slope=MIN_SLOPE),
        )  # fmt: skip
        kinds = [depth for _ in SIDES for depth in (None, None, *session.depths_mm, None)]
        frames = list(read_frames(place / "frames", SENSOR, reference))
        self._left = [f for f, depth in zip(frames, kinds, strict=True) if depth is not None]

    def errors(self, contact: Contact, session: Session, depth: float) -> dict[str, float]:
        """Take the next press and compare it with its simulation."""
        frame = self._left.pop(0)
        found = self.chain.measure_deformation(frame)
        assert frame.image is not None
        assert found.height is not None
        points, moved = gel_face(contact, session, depth)
        face = build_surface(SENSOR, points, moved)
        at = self.chain.tracker.reference_px
        _, told_mm = marker_displacements(SENSOR, at, found.markers_px)
        true_mm = _between(points, moved, SENSOR.to_mm(at))
        slope_true = np.stack(np.gradient(face.height_mm, 0.05)[::-1], axis=-1)
        free = found.height.zero_mean_mm - face.height_mm
        return {
            "slope_rms": _rms(self.calibration.slopes(frame.image) - slope_true),
            "depth_rms_mm": _rms(free - free.mean()),
            "marker_rms_mm": _rms((told_mm - true_mm)[:, :2]),
            "true_force_n": float((contact.force @ DOWN)[2]),
        }


def on_object(press: Press, contact: Contact, turn: np.ndarray) -> dict[str, float]:
    """Return the errors of a recorded press on the cube, relative to the simulation."""
    on = press.observed.all(axis=1)
    upright = (inversion_nodes()[on] - MIDDLE) @ turn.T + MIDDLE
    top = contact.nodes[:, 2] > SIDE - 1e-6
    truth = _between(contact.nodes[top], contact.displacement[top], upright[:, :2]) @ turn
    assert press.errors is not None
    covariance = press.errors.total_force_covariance
    return {
        "force_n": float(press.total_force @ press.direction),
        "force_deviation_n": float(np.sqrt(press.direction @ covariance @ press.direction)),
        "object_rms_mm": _rms(press.displacement[on] - truth),
        "object_size_mm": _rms(truth),
        "observed_nodes": int(on.sum()),
    }


def inversion_nodes() -> np.ndarray:
    """Nodes of the mesh of `object.edge_mm=1.25`."""
    axis = np.linspace(0.0, SIDE, 9)
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(values**2)))


def _between(points: np.ndarray, values: np.ndarray, places: np.ndarray) -> np.ndarray:
    return LinearNDInterpolator(points[:, :2], values)(places * (1.0 - 1e-9))


def inverted(place: Path, session: Any, *, gels: bool = True) -> dict[str, Any]:
    """Invert, and compare the inclusion that was found with the ball.

    Without the gels, forces are those that the deformation of the gel alone gives.
    """
    recording, folder = place / "recording.h5", place / "invert"
    if not gels:
        whole, folder = Recording.load(recording), place / "invert_forces"
        recording = place / "recording_forces.h5"
        presses = tuple(replace(press, gel=None) for press in whole.presses)
        replace(whole, presses=presses).save(recording)
    began = time.perf_counter()
    tactorch("invert", f"recording={recording}", "method=inclusions", f"run_dir={folder}")
    seconds = time.perf_counter() - began
    shapes = Reconstruction.load(folder / "reconstruction.h5").shapes
    assert shapes is not None
    ball = session.ball
    figures = {
        "inclusions": len(shapes.inclusions), "chi2": shapes.chi2,
        "around_mpa": shapes.background_mpa, "true_around_mpa": session.youngs_mpa,
        "true_mpa": ball.youngs_mpa, "force_deviation": shapes.force_deviation,
        "pose_deviation": shapes.pose_deviation, "seconds": seconds,
    }  # fmt: skip
    if not shapes.inclusions:
        return figures
    found = min(shapes.inclusions, key=lambda one: _off(one, ball))
    off = np.array(found.shape.center_mm) - ball.center_mm
    low, high = found.youngs_90_mpa
    return {
        **figures, "off_mm": float(np.linalg.norm(off)), "off_axes_mm": off.tolist(),
        "youngs_mpa": found.youngs_mpa, "youngs_90_mpa": [low, high],
        "within": bool(low <= ball.youngs_mpa <= high),
        "radius_mm": found.shape.radius_mm, "true_radius_mm": ball.radius_mm,
        "radius_90_mm": list(found.radius_90_mm),
        "probability": found.probability,
    }  # fmt: skip


def _off(found: ShapeInclusion, ball: Ball) -> float:
    return float(np.linalg.norm(np.array(found.shape.center_mm) - ball.center_mm))


def _found(name: str, forces: str, m: dict[str, Any]) -> str:
    """Return the row of a lump."""
    place = [""] * 5
    if "off_mm" in m:
        low, high = m["youngs_90_mpa"]
        place = [
            f"{m['off_mm']:.2f} mm", ", ".join(f"{v:+.2f}" for v in m["off_axes_mm"]),
            f"{m['radius_mm']:.2f} of {m['true_radius_mm']:g}",
            f"{m['youngs_mpa']:.3f} of {m['true_mpa']:g}", f"{low:.3f} to {high:.3f}",
        ]  # fmt: skip
    cells = [
        name, forces, str(m["inclusions"]), *place,
        f"{m['around_mpa']:.3f} of {m['true_around_mpa']:g}", f"{m['chi2']:.2f}",
        f"{m['seconds']:.0f}",
    ]  # fmt: skip
    return f"| {' | '.join(cells)} |"


def format_tables(results: dict[str, Any]) -> list[str]:
    """Return the tables as Markdown."""
    lines = [
        "| session | side | pressed by | slopes, rms | depth | markers | force | object |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for name, result in results.items():
        for one in result["presses"]:
            ratio = one["force_n"] / one["true_force_n"] - 1.0
            lines.append(
                f"| {name} | {one['side']} | {one['depth_mm']:g} mm | {one['slope_rms']:.4f} |"
                f" {one['depth_rms_mm']:.4f} mm | {one['marker_rms_mm']:.4f} mm |"
                f" {one['force_n']:.3f} +- {one['force_deviation_n']:.3f} of"
                f" {one['true_force_n']:.3f} N ({ratio:+.1%}) |"
                f" {one['object_rms_mm']:.4f} of {one['object_size_mm']:.3f} mm |"
            )
    return [*lines, "", *found_table(results)]


def found_table(results: dict[str, Any]) -> list[str]:
    """Return the table of the lumps that are found, as Markdown."""
    lines = [
        "| session | forces | lumps | off by | x, y, z | radius | ball, MPa | 90 % | around, MPa |"
        " chi2 | s |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]  # fmt: skip
    for name, result in results.items():
        lines += [_found(name, words, result[way]) for way, words in WAYS.items()]
    return lines


if __name__ == "__main__":
    main()

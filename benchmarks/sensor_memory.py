"""Peak memory of `tactorch sensor record` by the length of the session.

    python benchmarks/sensor_memory.py [--frames N ...] [--out FOLDER]

A simulated sensor (150 x 120 px, 35 markers) presses a ball into its gel again and again: 100
frames each, 80 of them with contact. The frames are a video, which `tactorch sensor record` reads
in a separate process; its peak resident memory is read at its end. A contact every 1,000 frames
becomes presses in a box, so that the sessions differ in their length and little in their results:
the others are of frames that the table of poses leaves far from the box. The last line printed is
one JSON object.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
from machine import write_results

from tactorch.sensor.calibration import (
    Ball,
    BallPress,
    Calibration,
    Circle,
    FitOptions,
    fit_map,
    image_change,
    marker_pixels,
    save_calibration,
)
from tactorch.sensor.description import GelLayer, MarkerGrid, SensorDescription, save_sensor
from tactorch.sensor.frames import Image
from tactorch.sensor.markers import MarkerAppearance
from tactorch.sensor.render import GelSurface, render

PACKAGES = ("tactorch", "torch", "kornia", "numpy", "opencv-python-headless")
SIZES = (500, 2_000, 10_000)
LIMIT_GIB = 2.0
SENSOR = SensorDescription(
    "drawn", (150, 120), (0.08, 0.08), GelLayer(3.0, 0.15, 0.45, size_mm=(12.0, 9.6)),
    MarkerGrid(7, 5, (1.6, 1.7), 0.45), frame_rate_hz=20.0,
)  # fmt: skip
_RADIUS_MM, _PERIOD, _FREE = 2.0, 100, 20  # of the ball; frames of a cycle, and without contact
_CONTACTS_PX = (5.0, 13.0)  # radius at first contact, and at the deepest
_PLACES = ((75.0, 60.0), (50.0, 45.0), (100.0, 75.0), (98.0, 44.0), (52.0, 78.0), (70.0, 44.0))
_SETTINGS = (
    "edge_mm=1.2", "layers=3", "steps=1", "object.size_mm=[6,6,4]", "object.edge_mm=1",
    "held_side=z-", "min_frames=5",
)  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> None:
    """Record the sessions; print the table and the JSON line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--frames", type=int, nargs="+", default=SIZES)
    parser.add_argument("--out", type=Path, help="folder for sensor_memory.md and .json")
    options = parser.parse_args(arguments)
    lines = ["| frames | contacts | presses | peak, GiB | s |", "|---|---|---|---|---|"]
    rows = []
    with TemporaryDirectory() as name:
        folder = Path(name)
        write_sensor(folder)
        for count in options.frames:
            write_session(folder, count)
            row = {"frames": count, **recorded(folder)}
            rows.append(row)
            lines.append(
                f"| {count} | {row['contacts']} | {row['presses']} | {row['peak_gib']:.3f} |"
                f" {row['seconds']:.0f} |"
            )
    result = {"sessions": rows, "limit_gib": LIMIT_GIB}
    if options.out is not None:
        write_results(options.out, "sensor_memory", lines, result, PACKAGES)
    print("\n".join(lines))
    print(json.dumps(result))


def surface(contact_px: float, center: tuple[float, float] = _PLACES[0]) -> GelSurface:
    """Return the gel under the ball, at rest for a contact of radius 0."""
    markers = SENSOR.to_px(SENSOR.markers.positions_mm)
    if contact_px == 0.0:
        return GelSurface(np.zeros(SENSOR.shape), markers)
    rows, columns = np.indices(SENSOR.shape)
    away = np.hypot(columns - center[0], rows - center[1]) * SENSOR.mm_per_px[0]
    edge = contact_px * SENSOR.mm_per_px[0]
    top = np.sqrt(_RADIUS_MM**2 - edge**2)
    rim = 0.35 * edge / top
    ball = top - np.sqrt(np.maximum(_RADIUS_MM**2 - away**2, 0.0)) - rim
    return GelSurface(np.where(away < edge, ball, -rim * np.exp(-(away - edge) / 0.35)), markers)


def write_sensor(folder: Path) -> None:
    """Write the sensor, its reference and a calibration by presses of the ball."""
    save_sensor(SENSOR, folder / "sensor.yaml")
    reference = render(SENSOR, surface(0.0), seed=100)
    _write_image(folder / "still.png", reference)
    look, ball = MarkerAppearance(0.45 / 0.08), Ball(_RADIUS_MM, SENSOR.mm_per_px)
    presses = []
    for seed, center in enumerate(_PLACES):
        image = render(SENSOR, surface(_CONTACTS_PX[1], center), seed=seed)
        change = image_change(image, reference, look)
        known = ~marker_pixels(image, reference, look)
        presses.append(BallPress(f"{seed}", change, known, Circle(center, _CONTACTS_PX[1])))
    slope_map, _ = fit_map(presses, ball, FitOptions("lookup", rounds=0))
    calibration = Calibration(slope_map, reference, SENSOR.mm_per_px, look)
    save_calibration(calibration, folder / "calib.npz")


def write_session(folder: Path, frames: int) -> None:
    """Write session.avi and poses.csv; a cycle of images is repeated."""
    cycle = [_cycle_contact(k) for k in range(_PERIOD)]
    images = [render(SENSOR, surface(contact), seed=k) for k, contact in enumerate(cycle)]
    codec = cv2.VideoWriter_fourcc(*"MJPG")
    video = cv2.VideoWriter(str(folder / "session.avi"), codec, 20.0, SENSOR.image_size_px)
    rows = ["time_s,x_mm,y_mm,z_mm,qw,qx,qy,qz"]
    for k in range(frames):
        video.write(cv2.cvtColor(images[k % _PERIOD], cv2.COLOR_RGB2BGR))
        depth_mm = (cycle[k % _PERIOD] * SENSOR.mm_per_px[0]) ** 2 / _RADIUS_MM
        height = 4.2 if depth_mm == 0.0 else 4.0 - depth_mm
        away = 3.0 if k % 1_000 < _PERIOD else 60.0  # beside the box
        rows.append(f"{k / 20.0:.3f},{away},3,{height:.4f},0,1,0,0")
    video.release()
    (folder / "poses.csv").write_text("\n".join(rows) + "\n")


def _cycle_contact(k: int) -> float:
    """Radius of the contact in a frame of the cycle, pixels."""
    if k < _FREE // 2 or k >= _PERIOD - _FREE // 2:
        return 0.0
    phase = (k - _FREE // 2) / (_PERIOD - _FREE)
    low, high = _CONTACTS_PX
    return low + (high - low) * float(np.sin(np.pi * phase))


def _write_image(path: Path, image: Image) -> None:
    cv2.imwrite(str(path), cv2.cvtColor(image, cv2.COLOR_RGB2BGR))


def recorded(folder: Path) -> dict[str, Any]:
    """Record the session in a process; return its peak memory, GiB, and what it found."""
    run, start = folder / "run", time.perf_counter()
    inputs = {
        "sensor": "sensor.yaml", "calibration": "calib.npz", "frames": "session.avi",
        "reference": "still.png", "poses": "poses.csv",
    }  # fmt: skip
    settings = [f"{name}={folder / file}" for name, file in inputs.items()]
    command = [sys.executable, "-m", "tactorch", "sensor", "record", *settings, *_SETTINGS]
    log = folder / "record.log"
    with log.open("w") as output:
        process = subprocess.Popen([*command, f"run_dir={run}"], stdout=output, stderr=output)
        _, status, usage = os.wait4(process.pid, 0)
    if status != 0:
        raise RuntimeError(log.read_text()[-2000:])
    summary = json.loads((run / "summary.json").read_text())
    return {
        "contacts": summary["contacts"],
        "presses": len(summary["presses"]),
        "peak_gib": usage.ru_maxrss / 2.0 ** (30 if sys.platform == "darwin" else 20),
        "seconds": time.perf_counter() - start,
    }


if __name__ == "__main__":
    main()

"""Slopes and heights by the differentiable camera and by the look-up, on images of known shape.

    python benchmarks/sensor_camera.py [--out FOLDER] [--shared FOLDER]

Rendered: 12 presses of a ball calibrate a simulated sensor with shadows and noise, whose contacts
are detected; 6 presses at other places and depths are evaluated. The lamps of the renderer are not
known to the calibration, whose model of light has no shadows. Measured (with the shared data): a
ball and a prism of known depth, with 22 presses of the ball, and a GelSight Mini with 18 presses of
a ball and 6 left out. Errors of slopes are mean absolute ones within 0.9 of the contacts, those of
heights root mean squares within the contacts. The last line printed is one JSON object.
"""

import argparse
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from machine import write_results

from tactorch.sensor.calibration import (
    Ball,
    BallPress,
    Calibration,
    FitOptions,
    SlopeMap,
    evaluate_map,
    find_circle,
    fit_map,
    image_change,
    read_labels,
)
from tactorch.sensor.calibration.camera import CameraLight, CameraMap
from tactorch.sensor.calibration.fit import fit_new_contact, fit_to_contacts
from tactorch.sensor.description import GelLayer, SensorDescription
from tactorch.sensor.frames import Image, read_image
from tactorch.sensor.render import GelSurface, render

PACKAGES = ("tactorch", "torch", "kornia", "numpy", "opencv-python-headless")
SENSOR = SensorDescription(
    "drawn", (240, 180), (0.06, 0.06), GelLayer(4.0, 0.2, 0.45, size_mm=(15.0, 11.0))
)
_RADIUS_MM = 2.5
Row = dict[str, Any]


def main(arguments: Sequence[str] | None = None) -> None:
    """Evaluate; print the table and the JSON line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, help="folder for sensor_camera.md and .json")
    shared = os.environ.get("TACTORCH_SHARED")
    parser.add_argument("--shared", type=Path, default=None if shared is None else Path(shared))
    options = parser.parse_args(arguments)
    rows = rendered()
    if options.shared is not None:
        rows += known_depth(options.shared / "data/known-depth")
        rows += left_out(options.shared / "data/fots-mini")
    names = list(dict.fromkeys(name for row in rows for name in row))
    lines = [f"| {' | '.join(names)} |", f"|{'---|' * len(names)}"]
    lines += [f"| {' | '.join(_text(row.get(name, '')) for name in names)} |" for row in rows]
    if options.out is not None:
        write_results(options.out, "sensor_camera", lines, {"rows": rows}, PACKAGES)
    print("\n".join(lines))
    print(json.dumps({"rows": rows}))


def _text(value: Any) -> str:
    return f"{value:.4f}" if isinstance(value, float) else str(value)


def calibrated(
    presses: Sequence[BallPress], ball: Ball, reference: Image
) -> tuple[Calibration, CameraMap]:
    """Return the calibration by the network, with the light, and the inverse camera."""
    found, fitted = fit_map(presses, ball, FitOptions("mlp_colour"))
    camera = fit_to_contacts(CameraLight(), fitted, found, ball)
    assert isinstance(camera, CameraMap)
    return Calibration(found, reference, ball.mm_per_px, light=camera.light), camera


def heights(
    calibration: Calibration, cases: Sequence[tuple[Image, np.ndarray, np.ndarray]]
) -> dict[str, float]:
    """Root mean square errors of the height, mm, inside masks: look-up, and fit."""
    errors = {}
    for depth in ("lookup", "fit"):
        squares = [
            np.mean((calibration.height(image, depth=depth).height_mm - true)[inside] ** 2)
            for image, true, inside in cases
        ]
        errors[f"height, {depth}, mm"] = float(np.sqrt(np.mean(squares)))
    return errors


def slopes(maps: dict[str, SlopeMap], presses: Sequence[BallPress], ball: Ball) -> dict[str, float]:
    """Mean absolute errors of the slopes, and of the height by them up to a constant."""
    errors: dict[str, float] = {}
    for name, slope_map in maps.items():
        quality = evaluate_map(slope_map, presses, ball)
        errors[f"slope, {name}"] = float(np.mean(quality.mae))
        errors[f"height up to a constant, {name}, mm"] = quality.depth_rms_mm
    return errors


def surface(center: tuple[float, float], contact_mm: float) -> tuple[np.ndarray, np.ndarray]:
    """Height of the gel under the ball on an elastic half-space (Hertz), and the contact."""
    rows, columns = np.indices(SENSOR.shape)
    r = np.hypot(columns - center[0], rows - center[1]) * SENSOR.mm_per_px[0]
    depth = contact_mm**2 / _RADIUS_MM
    ratio = np.minimum(contact_mm / np.maximum(r, 1e-9), 1.0)
    outside = (2 - 1 / ratio**2) * np.arcsin(ratio) + np.sqrt(1 - ratio**2) / ratio
    height = np.where(r < contact_mm, r**2 / (2 * _RADIUS_MM) - depth, -depth / np.pi * outside)
    return height, r < contact_mm


def rendered() -> list[Row]:
    """Evaluate presses of the ball that are rendered."""
    rng, bare = np.random.default_rng(0), np.zeros((0, 2))
    reference = render(SENSOR, GelSurface(np.zeros(SENSOR.shape), bare), seed=99)
    ball, images = Ball(_RADIUS_MM, SENSOR.mm_per_px), []
    for seed in range(18):
        center = tuple(rng.uniform((55, 50), (185, 130)).tolist())
        height, contact = surface(center, rng.uniform(0.7, 1.1))
        images.append((render(SENSOR, GelSurface(height, bare), seed=seed), height, contact))
    presses = [_press(f"{k}", image, reference, ball) for k, (image, *_) in enumerate(images)]
    calibration, camera = calibrated(presses[:12], ball, reference)
    held = [fit_new_contact(press, calibration.map, ball) for press in presses[12:]]
    maps = {"network": calibration.map, "camera": camera}
    return [
        {"data": "rendered balls", **slopes(maps, held, ball), **heights(calibration, images[12:])}
    ]


def _press(name: str, image: Image, reference: Image, ball: Ball) -> BallPress:
    change = image_change(image, reference)
    known = np.ones(change.shape[:2], dtype=bool)
    return BallPress(name, change, known, find_circle(change, ball, name))


def known_depth(folder: Path) -> list[Row]:
    """Evaluate a ball and a prism that were pressed to known depths."""
    radius, size = 2.92, 0.059259
    ball, reference = Ball(radius, (size, size)), read_image(folder / "still.png")
    names = read_labels(folder / "labels.csv")
    presses = [_press(n, read_image(folder / "balls" / n), reference, ball) for n in names]
    calibration, _ = calibrated(presses, ball, reference)
    rows, columns = np.mgrid[:320, :320]
    distance = np.hypot(columns - 208, rows - 166) * size
    prism = (abs(columns - 207) <= 35) & (abs(rows - 167) <= 53)
    results = []
    for shape in ("sphere", "prism"):
        cases = []
        for depth in (0.25, 0.5, 0.75, 1.0):
            below = np.sqrt(np.maximum(radius**2 - distance**2, 0.0)) - (radius - depth)
            true, inside = (-below, below > 0) if shape == "sphere" else (0 * below - depth, prism)
            cases.append((read_image(folder / shape / f"{shape}_{depth}_real.png"), true, inside))
        results.append({"data": f"known depth, {shape}", **heights(calibration, cases)})
    return results


def left_out(folder: Path) -> list[Row]:
    """Evaluate slopes of presses of a GelSight Mini that are left out."""
    ball = Ball(2.35, (1 / 19.58, 1 / 19.58))
    reference = read_image(folder / "bg/gelsight_bg.png")
    names = list(read_labels(folder / "labels.csv"))
    presses = [_press(n, read_image(folder / "gelsight" / n), reference, ball) for n in names]
    order = np.random.default_rng(0).permutation(len(presses))
    calibration, camera = calibrated([presses[k] for k in order[6:]], ball, reference)
    held = [fit_new_contact(presses[k], calibration.map, ball) for k in order[:6]]
    maps = {"network": calibration.map, "camera": camera}
    return [{"data": "GelSight Mini, left out", **slopes(maps, held, ball)}]


if __name__ == "__main__":
    main()

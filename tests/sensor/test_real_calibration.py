"""Calibration with real presses of balls, which others took: `-m external`."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tactorch.sensor.calibration import (
    Ball,
    BallPress,
    Calibration,
    Circle,
    FitOptions,
    cross_validate,
    evaluate_map,
    find_circle,
    fit_map,
    image_change,
    marker_pixels,
    read_labels,
)
from tactorch.sensor.calibration.camera import CameraLight, CameraMap
from tactorch.sensor.calibration.fit import fit_new_contact, fit_to_contacts
from tactorch.sensor.frames import read_image
from tactorch.sensor.markers import MarkerAppearance

pytestmark = pytest.mark.external


@pytest.fixture(scope="module")
def presses(shared_data: Path) -> tuple[list[BallPress], Ball]:
    """24 presses of a ball on a GelSight Mini; circles found, not those of the labels."""
    folder = shared_data / "fots-mini"
    ball = Ball(2.35, (1 / 19.58, 1 / 19.58))
    reference = read_image(folder / "bg/gelsight_bg.png")
    known = np.ones(reference.shape[:2], dtype=bool)
    found = []
    for name in read_labels(folder / "labels.csv"):
        changed = image_change(read_image(folder / "gelsight" / name), reference)
        found.append(BallPress(name, changed, known, find_circle(changed, ball, name)))
    return found, ball


def test_balls_are_found_near_their_labels(
    presses: tuple[list[BallPress], Ball], shared_data: Path
) -> None:
    labels = read_labels(shared_data / "fots-mini/labels.csv")
    off = [
        np.hypot(*np.subtract(touch.circle.center_px, labels[touch.name].center_px))
        for touch in presses[0]
    ]
    assert max(off) < 12.0  # labels are rough themselves


@pytest.mark.slow
def test_held_out_presses(presses: tuple[list[BallPress], Ball], shared_data: Path) -> None:
    """18 presses fit, 6 are held out, to which their circles alone are fitted."""
    touches, ball = presses
    order = np.random.default_rng(0).permutation(len(touches))
    held, used = ([touches[k] for k in part] for part in (order[:6], order[6:]))
    found, _ = fit_map(used, ball, FitOptions())
    held = [fit_new_contact(touch, found, ball) for touch in held]
    quality = evaluate_map(found, held, ball)  # within 0.9 of the whole contacts
    assert min(quality.r2) > 0.95
    assert max(quality.mae) < 0.09
    labels = read_labels(shared_data / "fots-mini/labels.csv")
    for fraction, r2, depth_mm in ((1.0, 0.95, 0.07), (0.7, 0.94, 0.05)):
        circles = [Circle(p.contact.center_px, fraction * labels[p.name].radius_px) for p in held]
        same = [replace(p, fitted=circle) for p, circle in zip(held, circles, strict=True)]
        quality = evaluate_map(found, same, ball)
        assert min(quality.r2) > r2, fraction
        assert quality.depth_rms_mm < depth_mm, fraction
    off = [abs(press.contact.radius_px - labels[press.name].radius_px) for press in held]
    assert np.median(off) < 4.0


@pytest.mark.slow
def test_six_presses_through_markers(shared_data: Path) -> None:
    """Each of the six left out once; the network that does not know the place."""
    folder = shared_data / "bnz-ball-markers"
    ball, look = Ball(1.98, (0.03026, 0.03026)), MarkerAppearance(14.0)
    reference = read_image(folder / "cali_180110/frame0.jpg")
    touches = []
    for name, label in read_labels(folder / "derived_ball_labels.csv").items():
        image = read_image(folder / "cali_180110" / name)
        known = ~marker_pixels(image, reference, look)
        circle = Circle(label.center_px, 42.0)  # its own radius is that of a table, and loose
        change = image_change(image, reference, look)
        touches.append(BallPress(name, change, known, circle, labeled=True))
    options = FitOptions("mlp_colour", rounds=3)
    quality = cross_validate(touches, ball, options, folds=len(touches))
    assert min(quality.r2) > 0.94
    assert max(quality.mae) < 0.06  # within 38 px; beyond, the colours of slopes hardly differ
    assert quality.depth_rms_mm < 0.045


@pytest.mark.slow
def test_known_depths_from_a_calibration_without_labels(shared_data: Path) -> None:
    """Heights of a ball and a prism pressed to known depths; 22 presses of the ball calibrate."""
    folder = shared_data / "known-depth"
    mm_per_px, radius = 0.059259, 2.92
    ball, reference = Ball(radius, (mm_per_px, mm_per_px)), read_image(folder / "still.png")
    labels = read_labels(folder / "labels.csv")
    presses = []
    for name in labels:
        change = image_change(read_image(folder / "balls" / name), reference)
        known = np.ones(change.shape[:2], dtype=bool)
        presses.append(BallPress(name, change, known, find_circle(change, ball, name)))
    found, fitted = fit_map(presses, ball, FitOptions("mlp_colour"))
    assert not any(press.outlying for press in fitted)
    off = np.array([p.contact.center_px for p in fitted]) - [
        labels[p.name].center_px for p in fitted
    ]
    assert np.median(np.hypot(*off.T)) < 2.5
    ratios = [p.contact.radius_px / labels[p.name].radius_px for p in fitted]
    assert 0.85 < np.median(ratios) < 1.1  # labels are where the imprint ends
    light = fit_to_contacts(CameraLight(), fitted, found, ball)
    assert isinstance(light, CameraMap)
    calibration = Calibration(found, reference, ball.mm_per_px, light=light.light)
    rows, columns = np.mgrid[:320, :320]
    distance = np.hypot(columns - 208, rows - 166) * mm_per_px
    for shape, depth_method, most in (
        ("sphere", "lookup", 0.068), ("prism", "lookup", 0.06),
        ("sphere", "fit", 0.072), ("prism", "fit", 0.056),
    ):  # fmt: skip
        squares = []
        for depth in (0.25, 0.5, 0.75, 1.0):
            image = read_image(folder / shape / f"{shape}_{depth}_real.png")
            height = calibration.height(image, depth=depth_method).height_mm
            below = np.sqrt(np.maximum(radius**2 - distance**2, 0.0)) - (radius - depth)
            inside, true = below > 0, -below
            if shape == "prism":
                inside = (abs(columns - 207) <= 35) & (abs(rows - 167) <= 53)
                true = np.full(inside.shape, -depth)
            squares.append(np.mean((height - true)[inside] ** 2))
        assert np.sqrt(np.mean(squares)) < most, (shape, depth_method)

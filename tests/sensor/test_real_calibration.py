"""Calibration with real presses of balls, which others took: `-m external`."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tactorch.sensor.calibration import (
    Ball,
    BallPress,
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
from tactorch.sensor.calibration.fit import fit_new_contact
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
    quality = evaluate_map(found, held, ball)
    assert min(quality.r2) > 0.94
    assert max(quality.mae) < 0.06
    assert quality.depth_rms_mm < 0.05
    # Nor is that only where the fit chose to look: within 0.72 of the labels' radii. Farther out
    # this sensor's colours hardly change any more.
    labels = read_labels(shared_data / "fots-mini/labels.csv")
    wide = [
        replace(touch, fitted=Circle(touch.contact.center_px, 0.8 * labels[touch.name].radius_px))
        for touch in held
    ]
    quality = evaluate_map(found, wide, ball)
    assert min(quality.r2) > 0.94
    assert quality.depth_rms_mm < 0.05


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
        touches.append(BallPress(name, image_change(image, reference, look), known, circle))
    options = FitOptions("mlp_colour", rounds=3)
    quality = cross_validate(touches, ball, options, folds=len(touches))
    assert min(quality.r2) > 0.94
    assert max(quality.mae) < 0.05
    assert quality.depth_rms_mm < 0.05

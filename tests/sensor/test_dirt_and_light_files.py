"""Drawn images of dirt beside a marker and of another light, made by others: `-m external`."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tactorch.sensor.calibration import (
    Ball,
    BallPress,
    Calibration,
    FitOptions,
    find_circle,
    fit_map,
    image_change,
)
from tactorch.sensor.frames import read_image
from tactorch.sensor.markers import MarkerAppearance, MarkerTracker, detect_markers

pytestmark = pytest.mark.external

LOOK = MarkerAppearance(16.0)


@pytest.fixture(scope="module")
def folder(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    script, out = (
        shared_data / "failing-inputs/importers/make_inputs.py",
        tmp_path_factory.mktemp("i"),
    )
    for case in ("dust_next_to_marker", "light_drift"):
        subprocess.run([sys.executable, str(script), str(out), case], check=True)
    return out


@pytest.mark.parametrize("speck", ["13_8", "15_6", "14_5", "13_5", "12_6", "16_8"])
def test_a_speck_beside_a_marker(folder: Path, speck: str) -> None:
    place = np.loadtxt(folder / "marker_place.txt")
    tracker = MarkerTracker(read_image(folder / "markers_rest.png"), LOOK)
    marker = int(np.linalg.norm(tracker.reference_px - place, axis=1).argmin())
    image = read_image(folder / f"markers_speck_{speck}.png")
    assert np.linalg.norm(detect_markers(image, LOOK) - place, axis=1).min() < 0.2
    moved = np.linalg.norm(tracker.track(image) - tracker.reference_px, axis=1)
    assert moved.max() < 0.2
    assert list(np.flatnonzero(tracker.covered)) == [marker]


def test_depth_under_another_light(folder: Path) -> None:
    ball, still = Ball(1.5, (0.05, 0.05)), read_image(folder / "light/still.png")
    presses = []
    for path in sorted((folder / "light/balls").glob("*.png")):
        change = image_change(read_image(path), still)
        known = np.ones(change.shape[:2], dtype=bool)
        presses.append(BallPress(path.name, change, known, find_circle(change, ball, path.name)))
    calibration = Calibration(
        fit_map(presses, ball, FitOptions("lookup", rounds=2))[0], still, ball.mm_per_px
    )
    paths = sorted((folder / "light/frames").glob("*.png"))
    heights = [calibration.height(read_image(path)) for path in paths]
    np.testing.assert_allclose([h.depth_mm for h in heights], heights[0].depth_mm, rtol=0.01)
    factors = [h.light.factor for h in heights if h.light is not None]
    np.testing.assert_allclose(factors, (1.0, 0.9, 0.95, 1.05, 1.1), atol=0.005)

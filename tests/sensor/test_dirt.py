"""Markers beside dirt or partly covered are measured by the rest of their edge, or dropped."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from tactorch.sensor.markers import MarkerAppearance, MarkerTracker, detect_markers

from .dots import draw, grid, pressed

LOOK = MarkerAppearance(16.0)
PLACES = grid(5, 7, 44.0)
COVERED = 17
ROWS, COLUMNS = np.mgrid[:240, :320].astype(float)


def image(places: np.ndarray = PLACES, seed: int = 1) -> np.ndarray:
    return draw(places, radius=8.0, seed=seed)


def painted(below: np.ndarray, opacity: np.ndarray, gray: float) -> np.ndarray:
    opacity = opacity[..., None]
    return (below * (1 - opacity) + gray * opacity).astype(np.uint8)


def disc(x: float, y: float, radius: float) -> np.ndarray:
    return np.clip(radius + 0.5 - np.hypot(COLUMNS - x, ROWS - y), 0, 1)


def hair(x: float, y: float, width: float) -> np.ndarray:
    across = (ROWS - y) * np.cos(0.4) - (COLUMNS - x) * np.sin(0.4)
    return np.clip(0.5 * width + 0.5 - np.abs(across), 0, 1)


def half(x: float, y: float, off: float) -> np.ndarray:
    along = (COLUMNS - x) * np.cos(0.6) + (ROWS - y) * np.sin(0.6)
    return np.clip(along - off + 0.5, 0, 1) * disc(x, y, 14.0)


def nearest(found: np.ndarray, place: np.ndarray) -> float:
    return float(cKDTree(found).query(place)[0])


def check(dirty: np.ndarray, places: np.ndarray = PLACES, *, most_px: float = 0.5) -> None:
    """The marker is right or dropped when detected and when tracked, and is reported."""
    off = nearest(detect_markers(dirty, LOOK), places[COVERED])
    assert off < most_px or off > 16.0
    tracker = MarkerTracker(image(seed=0), LOOK)
    order = cKDTree(tracker.reference_px).query(PLACES)[1]
    found = tracker.track(dirty)[order]
    errors = np.linalg.norm(found - tracker.reference_px[order] - (places - PLACES), axis=1)
    assert not errors[COVERED] >= most_px  # NaN if dropped
    assert np.nanmax(np.delete(errors, COVERED)) < 0.8  # a hair may cross others, too
    if np.isnan(errors[COVERED]):
        assert tracker.covered[order[COVERED]]
        assert "of 35 markers are covered or beside dirt" in tracker.fault


@pytest.mark.parametrize("amount", [0.0, 4.0])
@pytest.mark.parametrize(
    ("away", "radius"), [(13, 8), (15, 6), (14, 5), (13, 5), (12, 6), (16, 8), (10, 3), (9, 9)]
)
def test_a_speck_beside_a_marker(away: float, radius: float, amount: float) -> None:
    places = pressed(PLACES, amount)
    x, y = places[COVERED]
    speck = disc(x + away * np.cos(0.6), y + away * np.sin(0.6), radius)
    dirty = painted(image(places), speck, 30.0)
    check(dirty, places)


@pytest.mark.parametrize("gray", [30.0, 220.0])
@pytest.mark.parametrize("width", [2.0, 4.0])
def test_a_hair_across_markers(gray: float, width: float) -> None:
    x, y = PLACES[COVERED]
    check(painted(image(), hair(x + 2.0, y - 3.0, width), gray))


@pytest.mark.parametrize(("off", "gray"), [(0.0, 240.0), (4.0, 240.0), (0.0, 30.0), (-5.0, 30.0)])
def test_glare_and_dark_blobs(off: float, gray: float) -> None:
    check(painted(image(), half(*PLACES[COVERED], off), gray))


def test_a_marker_that_leaves_the_image() -> None:
    """Moved to the left by 20 px, the first column is half outside."""
    tracker = MarkerTracker(image(seed=0), LOOK)
    order = cKDTree(tracker.reference_px).query(PLACES)[1]
    for step in (5.0, 10.0, 15.0, 20.0):
        moved = tracker.track(image(PLACES - (step, 0.0)))[order] - tracker.reference_px[order]
    assert np.nanmax(np.linalg.norm(moved - [-20.0, 0.0], axis=1)) < 0.7


def test_several_specks() -> None:
    dirty, specks = image(), [3, 10, 17, 24]
    for marker in specks:
        dirty = painted(dirty, disc(*(PLACES[marker] + (9.0, 8.0)), 5.0), 30.0)
    tracker = MarkerTracker(image(seed=0), LOOK)
    order = cKDTree(tracker.reference_px).query(PLACES)[1]
    moved = np.linalg.norm(tracker.track(dirty) - tracker.reference_px, axis=1)[order]
    assert np.nanmax(moved) < 0.5
    assert set(np.flatnonzero(tracker.covered[order])) == set(specks)


def test_a_hidden_row_of_markers() -> None:
    """Too many are half covered to correct them: 7 of 35."""
    dirty = image()
    dirty[: int(PLACES[:, 1].min()) + 2] = 150
    tracker = MarkerTracker(image(seed=0), LOOK)
    tracker.track(dirty)
    assert tracker.unlike >= 7
    assert f"{tracker.unlike} of 35 markers do not look as in the reference" in tracker.fault
    tracker.track(image())
    assert tracker.fault == ""


@pytest.mark.parametrize("shown", [image(PLACES[:0]), 255 - image()], ids=["none", "inverted"])
def test_no_marker_is_found(shown: np.ndarray) -> None:
    tracker = MarkerTracker(image(seed=0), LOOK)
    assert np.isnan(tracker.track(shown)).all()
    assert tracker.fault == "no marker is found"
    tracker.track(None)
    assert tracker.fault == ""


def test_clean_markers_are_not_reported() -> None:
    tracker = MarkerTracker(image(seed=0), LOOK)
    assert np.isfinite(tracker.track(image(pressed(PLACES, 4.0)))).all()
    assert tracker.fault == ""
    assert tracker.left_out == 0


def test_a_covered_marker_of_the_reference_is_left_out(caplog: pytest.LogCaptureFixture) -> None:
    dirty = painted(image(), half(*PLACES[COVERED], -2.0), 240.0)
    assert len(detect_markers(dirty, LOOK)) == len(PLACES) - 1
    assert "1 spots are left out" in caplog.text
    assert MarkerTracker(dirty, LOOK).left_out == 1

"""Markers in real images, which others took: `-m external`."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from tactorch.sensor.frames import open_source, read_image
from tactorch.sensor.markers import MarkerAppearance, MarkerTracker, detect_markers

pytestmark = pytest.mark.external

LOOK = MarkerAppearance(18.0)


@pytest.mark.parametrize(
    ("name", "diameter", "count"),
    [
        ("feats-mini-gel/cuboid_10-2-284.png", 9.0, 63),  # 9 x 7, as its source says
        ("fots-mini/marker/0.png", 11.0, 99),  # 11 x 9, likewise
        ("bnz-ball-markers/track_markers/frame0.png", 18.0, 126),
        ("bnz-ball-markers/cali_180110/frame0.jpg", 14.0, 86),
    ],
)
def test_all_markers_are_found(shared_data: Path, name: str, diameter: float, count: int) -> None:
    found = detect_markers(read_image(shared_data / name), MarkerAppearance(diameter))
    assert abs(len(found) - count) <= 2  # those that the image's edge cuts


@pytest.fixture(scope="module")
def images(shared_data: Path) -> list[np.ndarray]:
    video = shared_data / "bnz-ball-markers/track_markers/video.avi"
    return [frame.image for frame in open_source(video)]


@pytest.fixture(scope="module")
def reference(images: list[np.ndarray]) -> np.ndarray:
    """The mean of the frames without contact."""
    return np.mean(images[:11], axis=0).round().astype(np.uint8)


@pytest.fixture(scope="module")
def tracked(images: list[np.ndarray], reference: np.ndarray) -> np.ndarray:
    return np.stack([*map(MarkerTracker(reference, LOOK).track, images)])


@pytest.mark.slow
def test_without_contact_nothing_moves(tracked: np.ndarray, reference: np.ndarray) -> None:
    begin = MarkerTracker(reference, LOOK).reference_px
    moved = np.linalg.norm(tracked[:11] - begin, axis=2)
    assert np.median(moved) < 0.12
    assert np.percentile(moved, 95) < 0.3
    assert moved.max() < 0.6


@pytest.mark.slow
def test_markers_keep_their_identity(tracked: np.ndarray, images: list[np.ndarray]) -> None:
    """Followed back from the last frame, each comes out where it began."""
    always = np.isfinite(tracked).all(axis=(0, 2))
    assert always.sum() >= 118
    back = MarkerTracker(images[-1], LOOK)
    for image in images[-2::-1]:
        found = back.track(image)
    distance, place = cKDTree(back.reference_px).query(np.nan_to_num(tracked[-1], nan=-99.0))
    same = always & (distance < 2.0)
    assert same.sum() == always.sum()
    off = np.linalg.norm(found[place[same]] - tracked[0][same], axis=1)
    assert np.nanmedian(off) < 0.15
    assert (off < 0.5).mean() > 0.97
    assert np.nanmax(off) < 1.5


@pytest.mark.slow
def test_neighbours_move_alike_all_along(tracked: np.ndarray) -> None:
    """Motion of up to 47 px varies smoothly: no marker is taken for another (66 px apart)."""
    begin = tracked[0]
    _, near = cKDTree(begin).query(begin, k=5)
    for places in tracked[::4]:
        moved = places - begin
        off = np.linalg.norm(moved - np.nanmedian(moved[near[:, 1:]], axis=1), axis=1)
        assert np.nanmax(off) < 20.0
    assert np.nanmax(np.linalg.norm(tracked - begin, axis=2)) > 40.0


@pytest.mark.slow
@pytest.mark.parametrize("step", [8, 12])
def test_stills_of_the_press_keep_their_identity(
    tracked: np.ndarray, images: list[np.ndarray], reference: np.ndarray, step: int
) -> None:
    """One image in so many: steps of up to 47 px, and the places that the whole video has."""
    seen, wrong, count = 0, 0, 0
    for first in range(0, step, 3):
        tracker = MarkerTracker(reference, LOOK)
        for number in range(first, len(images), step):
            found = tracker.track(images[number])
            off = np.linalg.norm(found - tracked[number], axis=1)
            seen += int(np.isfinite(found[:, 0]).sum())
            wrong += int((off > 0.4 * tracker.spacing_px).sum())
            count += len(found)
    assert wrong == 0
    assert seen > 0.97 * count

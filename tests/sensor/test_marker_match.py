"""Stills between which markers move by a pitch and more: none is taken for another, silently."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from tactorch.sensor.marker_match import Grid, match_markers
from tactorch.sensor.markers import MarkerAppearance, MarkerTracker

from . import jumps

LOOK = MarkerAppearance(12.0)
WRONG_PX = 0.4 * jumps.PITCH


def grid_of(places: np.ndarray) -> Grid:
    """The grid without an image."""
    distance, near = cKDTree(places).query(places, k=9)
    return Grid(places, near[:, 1:], float(np.median(distance[:, 1])), jumps.SHAPE[::-1], 0.35)


@pytest.mark.parametrize("name", sorted(jumps.moved(jumps.lattice(0.0, 0))))
@pytest.mark.parametrize(("jitter", "missing"), [(0.0, 0.0), (3.0, 0.05)])
def test_spots_are_assigned_after_any_jump(name: str, jitter: float, missing: float) -> None:
    """All that are there, or all are said to be in doubt (a twist that halves distances)."""
    places, rng = jumps.lattice(jitter, 1), np.random.default_rng(2)
    now = jumps.moved(places)[name]
    there = rng.random(len(now)) >= missing
    spots = (now + rng.normal(0.0, 0.3, now.shape))[there]
    match = match_markers(grid_of(places), spots[rng.permutation(len(spots))])
    if name == "twisted by 40 degrees":
        assert match.ambiguous.all()
        return
    off = np.linalg.norm(match.positions - now, axis=1)
    seen = np.isfinite(match.positions[:, 0])
    assert off[seen].max() < 2.0
    assert not (seen & ~there).any()
    assert seen[there].mean() > 0.98
    assert match.ambiguous.mean() < 0.05


def test_a_grid_without_borders_in_view_is_ambiguous_after_half_a_pitch() -> None:
    """Left or right, nothing tells: the image is full of markers, all alike."""
    places = jumps.lattice(0.0, 0, 15, 19)
    inside = ((places > 5) & (places < np.array(jumps.SHAPE[::-1]) - 5)).all(axis=1)
    grid = grid_of(places[inside])
    shifted = places + np.array([0.5 * jumps.PITCH, 0.0])
    inside = ((shifted > 5) & (shifted < np.array(jumps.SHAPE[::-1]) - 5)).all(axis=1)
    assert match_markers(grid, shifted[inside]).ambiguous.mean() > 0.9


def test_no_spots_are_no_match() -> None:
    match = match_markers(grid_of(jumps.lattice(0.0, 0)), np.zeros((0, 2)))
    assert np.isnan(match.positions).all()


@pytest.mark.slow
@pytest.mark.parametrize("jitter", [0.0, 4.0])
def test_a_tracker_survives_stills(jitter: float) -> None:
    """One still after another; then the gel at rest is found again."""
    places = jumps.lattice(jitter, 3)
    tracker = MarkerTracker(jumps.image(places, 50), LOOK)
    order = cKDTree(places).query(tracker.reference_px)[1]
    for number, (name, now) in enumerate(jumps.moved(places).items()):
        found = tracker.track(jumps.image(now, number))
        seen = np.isfinite(found[:, 0])
        assert (np.linalg.norm(found - now[order], axis=1)[seen] < WRONG_PX).all(), name
        if name == "twisted by 40 degrees":
            assert tracker.ambiguous.all()
        else:
            assert seen.mean() > 0.97, name
    back = tracker.track(jumps.image(places, 60))
    assert np.linalg.norm(back - tracker.reference_px, axis=1).max() < 0.5
    assert tracker.reassigned
    tracker.track(jumps.image(places, 61))
    assert not tracker.reassigned

"""Markers are found to a fraction of a pixel, followed, and rather lost than mistaken."""

from collections.abc import Callable
from types import SimpleNamespace

import jaxtyping
import numpy as np
import pytest
from scipy.spatial import cKDTree

from tactorch.errors import ConfigError
from tactorch.sensor.chain import ChainOptions, SensorChain
from tactorch.sensor.depth import HeightMap
from tactorch.sensor.description import GelLayer, SensorDescription
from tactorch.sensor.frames import Frame
from tactorch.sensor.markers import (
    MarkerAppearance,
    MarkerTracker,
    TrackOptions,
    detect_markers,
    marker_displacements,
    marker_mask,
)

from .dots import draw, grid, pressed

LOOK = MarkerAppearance(10.0)


def errors(found: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Distance of each true place from the nearest found one."""
    return cKDTree(found).query(truth)[0]


@pytest.mark.parametrize("noise", [0.0, 4.0])
def test_markers_are_found_to_a_fraction_of_a_pixel(noise: float) -> None:
    places = grid()
    found = detect_markers(draw(places, noise=noise), LOOK)
    assert len(found) == len(places)
    off = errors(found, places)
    assert np.median(off) < 0.05
    assert off.max() < 0.15


def test_sizes_may_differ_and_light_may_be_strong() -> None:
    places = grid()
    radii = np.random.default_rng(2).uniform(3.0, 9.0, len(places))
    found = detect_markers(draw(places, radii=radii, flash=(150, 110)), LOOK)
    assert len(found) == len(places)
    assert errors(found, places).max() < 0.3


def test_merged_markers_are_divided_and_large_ones_are_not() -> None:
    places = np.array([(60.0, 60.0), (71.5, 60.0), (160.0, 120.0)])
    radii = np.array([5.0, 5.0, 9.0])
    found = detect_markers(draw(places, radii=radii), LOOK)
    assert len(found) == 3
    assert errors(found, places).max() < 0.7


@pytest.mark.parametrize(
    ("use", "says"),
    [
        (lambda image: detect_markers(image / 255.0, LOOK), "(240, 320, 3) of float64"),
        (lambda image: MarkerTracker(image[..., 0], LOOK), "(240, 320) of uint8"),
        (lambda image: MarkerTracker(image, LOOK).track(image / 255.0), "of float64; convert it"),
    ],
)
def test_images_of_other_types(
    use: Callable[[np.ndarray], object], says: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)  # as for users
    with pytest.raises(ConfigError, match=r"must be \(h, w, 3\) of uint8, not") as caught:
        use(draw(grid()))
    assert says in str(caught.value)


def test_dirt_is_no_marker() -> None:
    places = np.array([(60.0, 60.0), (160.0, 120.0)])
    found = detect_markers(draw(places, radii=np.array([5.0, 1.5])), LOOK)
    assert len(found) == 1


def test_a_gel_without_markers_has_none() -> None:
    assert len(detect_markers(draw(np.zeros((0, 2))), LOOK)) == 0


def test_the_mask_covers_the_markers() -> None:
    mask = marker_mask(draw(grid()), LOOK)
    x, y = grid().round().astype(int).T
    assert mask[y, x].all()
    assert 0.03 < mask.mean() < 0.12


def sequence(count: int, most: float, missing: float = 0.0) -> tuple[np.ndarray, np.ndarray, list]:
    """A press in `count` steps: true places, which are drawn, and images."""
    rng, begin = np.random.default_rng(4), grid()
    truth = np.stack([pressed(begin, most * i / (count - 1)) for i in range(count)])
    drawn = rng.random(truth.shape[:2]) >= missing
    drawn[0] = True
    images = [
        draw(now[seen], noise=3.0, seed=i, flash=(150 + 2 * i, 110))
        for i, (now, seen) in enumerate(zip(truth, drawn, strict=True))
    ]
    return truth, drawn, images


@pytest.mark.parametrize(
    ("most", "missing"),
    [
        pytest.param(20.0, 0.0, marks=pytest.mark.slow),
        pytest.param(20.0, 0.1, marks=pytest.mark.slow),
        (28.0, 0.1),
    ],
)
def test_known_motion_is_found(most: float, missing: float) -> None:
    truth, drawn, images = sequence(10, most, missing)
    reference = draw(truth[0], noise=0.0)
    tracker = MarkerTracker(reference, LOOK)
    order = cKDTree(truth[0]).query(tracker.reference_px)[1]
    assert sorted(order) == list(range(len(truth[0])))
    off, false, lost = [], 0, 0
    for there, seen, image in zip(truth[:, order], drawn[:, order], images, strict=True):
        found = tracker.track(image)
        valid = np.isfinite(found).all(axis=1)
        assert np.isnan(found[~valid]).all()
        moved, true = found - tracker.reference_px, there - truth[0][order]
        off.append(np.linalg.norm(moved - true, axis=1)[valid & seen])
        false += int((valid & ~seen).sum())
        lost += int((~valid & seen).sum())
    off = np.concatenate(off)
    assert np.median(off) <= 0.1
    assert np.percentile(off, 95) <= 0.5
    assert off.max() < 3.0  # never another marker
    assert false == 0
    assert lost <= 0.02 * drawn.sum()


def test_a_missing_frame_has_no_markers_and_the_next_goes_on() -> None:
    *_, images = sequence(6, 12.0)
    found = [*map(MarkerTracker(images[0], LOOK).track, [*images[:3], None, *images[4:]])]
    assert np.isnan(found[3]).all()
    assert np.isfinite(found[5]).mean() > 0.95


def test_a_marker_that_jumps_is_not_believed() -> None:
    """Two neighbours change places with holes beside them: no arrow rather than a wrong one."""
    places = grid()
    moved = places.copy()
    moved[31] += (9.0, 9.0)  # pitch 32: beyond what its neighbours do
    tracker = MarkerTracker(draw(places), LOOK, TrackOptions(max_deviation=0.2))
    i = int(cKDTree(tracker.reference_px).query(places[31])[1])
    found = tracker.track(draw(moved, seed=1))
    assert np.isnan(found[i]).all()
    assert np.isfinite(np.delete(found, i, axis=0)).all()
    again = tracker.track(draw(places, seed=2))
    assert np.isfinite(again).all()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: MarkerAppearance(1.0), "diameter_px=1"),
        (lambda: MarkerAppearance(9.0, min_area=2.0), "min_area=2"),
        (
            lambda: MarkerAppearance(9.0, contrast=40.0),
            "contrast=40.0: give a number above 0",
        ),
        (lambda: TrackOptions(gate=0.7), "gate=0.7"),
        (lambda: TrackOptions(neighbors=2), "neighbors=2"),
        (lambda: MarkerTracker(draw(grid()[:4]), LOOK), "4 markers were found.*9 are needed"),
        (lambda: MarkerTracker(draw(grid()), LOOK).track(draw(grid())[:-4]), "another|shape"),
    ],
)
def test_wrong_settings_are_refused(make: object, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        make()


def test_displacements_are_in_millimetres(make_sensor: Callable[..., SensorDescription]) -> None:
    """In plane by the pixels' size; along z by the height where the marker is now."""
    gel = GelLayer(4.0, 0.2, radius_mm=9.0, curvature_radius_mm=30.0)
    sensor = make_sensor(mm_per_px=(0.3, 0.25), gel=gel)
    begin = np.array([(31.5, 23.5), (41.5, 23.5), (10.0, 10.0)])
    places = np.array([(33.5, 19.5), (41.5, 23.5), (np.nan, np.nan)])
    rows, columns = np.mgrid[:48, :64]
    height = -0.01 * columns - 0.02 * rows
    points, moved = marker_displacements(sensor, begin, places, height)
    np.testing.assert_allclose(points[0], (0.0, 0.0, 0.0), atol=1e-12)
    np.testing.assert_allclose(points[1], (3.0, 0.0, np.sqrt(30**2 - 9) - 30), atol=1e-12)
    (fall,) = gel.height_mm(np.array([(0.6, -1.0)]))
    np.testing.assert_allclose(moved[0], (0.6, -1.0, -0.01 * 33.5 - 0.02 * 19.5 + fall))
    np.testing.assert_allclose(moved[1], (0.0, 0.0, -0.01 * 41.5 - 0.02 * 23.5), atol=1e-12)
    assert np.isnan(moved[2]).all()
    with pytest.raises(ConfigError, match="heights are"):
        marker_displacements(sensor, begin, places, height[:-1])


def test_nodes_have_the_height_of_the_place_they_have_moved_to(
    make_sensor: Callable[..., SensorDescription],
) -> None:
    gel = GelLayer(4.0, 0.2, radius_mm=9.0, curvature_radius_mm=30.0)
    sensor = make_sensor(mm_per_px=(0.3, 0.25), gel=gel)
    rows, columns = np.mgrid[:48, :64]
    height = -0.5 - 0.01 * columns - 0.02 * rows
    everywhere = np.ones(height.shape, dtype=bool)
    begin = np.array([(11.5, 3.5), (51.5, 3.5), (11.5, 43.5), (51.5, 43.5)])
    nodes = np.array([(0.0, 0.0, 0.0), (3.0, 0.0, np.sqrt(30**2 - 9) - 30)])
    chain = object.__new__(SensorChain)
    chain.sensor, chain.options = sensor, ChainOptions()
    chain.reference = np.zeros((48, 64, 3), np.uint8)
    chain.model = SimpleNamespace(points=nodes)
    moved = begin + np.array([2.0, -4.0])
    chain.tracker = SimpleNamespace(reference_px=begin, fault="", track=lambda image: moved)
    chain.calibration = SimpleNamespace(
        height=lambda *_, **__: HeightMap(height, height + 1.0, ~everywhere, everywhere)
    )
    found = chain.measure_deformation(Frame(0, "a.png", chain.reference))
    # Nodes are at columns 31.5 and 41.5, row 23.5, before all points move by 2 and -4 pixels.
    rise = 0.5 - 0.01 * np.array([33.5, 43.5]) - 0.02 * 19.5
    rise += gel.height_mm(np.array([(0.6, -1.0), (3.6, -1.0)])) - nodes[:, 2]
    np.testing.assert_allclose(found.displacement, np.column_stack([[0.6] * 2, [-1.0] * 2, rise]))

"""Slopes from colours: circles are found, rough ones are mended, and what was not seen is seen."""

import json
import logging
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest
import torch

from tactorch.config import registry
from tactorch.errors import ConfigError, FileError
from tactorch.sensor.calibration import (
    SENSOR_MAPS,
    Ball,
    BallPress,
    Calibration,
    Circle,
    FitOptions,
    MapQuality,
    evaluate_map,
    find_circle,
    fit_map,
    image_change,
    load_calibration,
    marker_pixels,
    quality,
    read_labels,
    save_calibration,
    select_map,
)
from tactorch.sensor.calibration.fit import fit_contact
from tactorch.sensor.calibration.maps import map_slopes
from tactorch.sensor.depth import reconstruct_height
from tactorch.sensor.markers import MarkerAppearance

from . import ball_images as drawn
from .dots import draw, grid

BALL = Ball(drawn.RADIUS_MM, (drawn.MM_PER_PX, drawn.MM_PER_PX))
CENTERS = [
    (float(x), float(y)) for y in (26.4, 47.1, 70.2) for x in (27.3, 55.8, 83.1)
]  # fmt: skip


def touches(centers: list, off_px: float = 0.0, seed: int = 0) -> list[BallPress]:
    """Presses whose circles are told wrongly by some pixels."""
    rng, reference = np.random.default_rng(seed), drawn.still()
    known = np.ones(drawn.SHAPE, dtype=bool)
    found = []
    for i, (x, y) in enumerate(centers):
        contact = 16.0 + i % 4
        wrong = rng.uniform(-off_px, off_px, 2)
        circle = Circle((x + wrong[0], y + wrong[1]), contact + off_px / 2)
        changed = image_change(drawn.ball((x, y), contact, seed=i), reference)
        found.append(BallPress(f"press {i}", changed, known, circle))
    return found


def test_the_balls_slopes_are_those_of_its_heights() -> None:
    circle = Circle((50.3, 44.8), 18.0)
    height, slope = BALL.heights(drawn.SHAPE, circle), BALL.slopes(drawn.SHAPE, circle)
    along, across = np.gradient(height, drawn.MM_PER_PX)
    inside = BALL.distance(drawn.SHAPE, circle) < 0.9
    np.testing.assert_allclose(slope[inside][:, 0], across[inside], atol=5e-3)
    np.testing.assert_allclose(slope[inside][:, 1], along[inside], atol=5e-3)
    assert height[45, 50] < -0.25  # the ball pushes into the sensor: down
    edge = np.abs(BALL.distance(drawn.SHAPE, circle) - 1.0) < 0.02
    np.testing.assert_allclose(height[edge], 0.0, atol=0.02)


@pytest.mark.parametrize("center", [(55.0, 48.0), (30.0, 66.0)])
def test_a_ball_is_found(center: tuple[float, float]) -> None:
    found = find_circle(image_change(drawn.ball(center), drawn.still()), BALL)
    assert np.hypot(*np.subtract(found.center_px, center)) < 4.0
    assert 10.0 < found.radius_px < 25.0


@pytest.mark.slow
def test_rough_circles_are_mended_and_held_out_slopes_are_seen() -> None:
    """Labels are up to 3 px off; a calibration that believes them stays far behind."""
    pressed = touches(CENTERS, off_px=3.0)
    new = touches([(41.2, 58.7), (69.4, 36.3)], seed=5)
    truth = [touch.circle for touch in new]
    believed, _ = fit_map(pressed, BALL, FitOptions(rounds=0))
    mended, fitted = fit_map(pressed, BALL, FitOptions(rounds=3))
    before, after = (evaluate_map(one, new, BALL) for one in (believed, mended))
    assert min(after.r2) > 0.97
    assert max(after.mae) < 0.6 * min(before.mae)
    assert after.depth_rms_mm < 0.02
    assert [press.name for press in fitted] == [touch.name for touch in pressed]
    found = np.array([press.contact.center_px for press in fitted])
    assert np.linalg.norm(found - CENTERS, axis=1).max() < 1.0
    rough = replace(new[0], fitted=Circle((44.0, 56.0), 14.0))
    one = fit_contact(rough, mended, BALL).contact
    assert np.hypot(*np.subtract(one.center_px, truth[0].center_px)) < 0.7
    assert abs(one.radius_px - truth[0].radius_px) < 3.0


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=pytest.mark.slow) if n == "camera" else n for n in SENSOR_MAPS.names()],
)
def test_every_map_learns_and_is_kept(name: str, tmp_path: Path) -> None:
    pressed = touches(CENTERS)
    found, _ = fit_map(pressed, BALL, FitOptions(name, rounds=0))
    (new,) = touches([(60.0, 52.0)], seed=8)
    assert min(evaluate_map(found, [new], BALL).r2) > 0.85
    kept = Calibration(
        found, drawn.still(), BALL.mm_per_px, MarkerAppearance(9.0), {"r2": [0.9, 0.8]}
    )
    save_calibration(kept, tmp_path / "calib.npz")
    again = load_calibration(tmp_path / "calib.npz")
    np.testing.assert_allclose(
        map_slopes(again.map, new.change), map_slopes(found, new.change), atol=1e-6
    )
    np.testing.assert_array_equal(again.reference, kept.reference)
    assert (again.mm_per_px, again.markers, again.facts) == (
        kept.mm_per_px,
        kept.markers,
        kept.facts,
    )
    still = map_slopes(found, image_change(drawn.still(3), drawn.still()))
    assert np.abs(still).mean() < 0.05


def test_the_same_seed_gives_the_same_map() -> None:
    pressed = touches(CENTERS[:2])
    one, other = (fit_map(pressed, BALL, FitOptions(rounds=0, seed=4))[0] for _ in range(2))
    for name, values in one.arrays().items():
        np.testing.assert_array_equal(values, other.arrays()[name])


def test_a_fit_limits_the_threads_of_torch_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    logger, fitting = logging.getLogger("another.package"), []
    monkeypatch.setattr(logger, "level", logging.INFO)
    step = torch.optim.Adam.step

    def watch(*arguments: object) -> object:
        fitting.append((logger.isEnabledFor(logging.INFO), torch.get_num_threads()))
        return step(*arguments)

    monkeypatch.setattr(torch.optim.Adam, "step", watch)
    threads = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        SENSOR_MAPS.build("mlp").create(0).fit(np.zeros((9, 5)), np.zeros((9, 2)), 0)
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(threads)
    assert set(fitting) == {(True, 1)}


def test_markers_do_not_count() -> None:
    """What they hide is filled in: the change is that of the gel beneath."""
    places, look = grid()[:20], MarkerAppearance(10.0)
    reference, plain = draw(places, noise=0.5), draw(np.zeros((0, 2)), noise=0.5)
    lit = reference.astype(int)
    lit[:, : lit.shape[1] // 3] += 30
    lit = np.clip(lit, 0, 255).astype(np.uint8)
    covered = marker_pixels(lit, reference, look)
    assert 0.01 < covered.mean() < 0.1
    x, y = places.round().astype(int).T
    assert covered[y, x].all()
    changed = image_change(lit, reference, look)
    inside = covered.copy()
    inside[:, lit.shape[1] // 3 - 12 :] = False
    assert inside.sum() > 100
    np.testing.assert_allclose(changed[inside], 0.6, atol=0.1)
    assert not marker_pixels(plain, plain, None).any()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("image,center_x_px,center_y_px\na.png,1,2\n", "lacks the column radius_px"),
        ("image,center_x_px,center_y_px,radius_px\n", "has no line"),
        ("image,center_x_px,center_y_px,radius_px\na.png,1,x,9\n", "line 2: could not convert"),
        (
            "image,center_x_px,center_y_px,radius_px\na.png,1,2,9\nb.png,1,2,1\n",
            "3: radius_px=1",
        ),
    ],
)
def test_tables_that_cannot_be_read(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "labels.csv").write_text(text)
    with pytest.raises(FileError, match=message) as caught:
        read_labels(tmp_path / "labels.csv")
    assert "labels.csv" in str(caught.value)


def test_tables_are_read(tmp_path: Path) -> None:
    path = tmp_path / "labels.csv"
    path.write_text("image,center_x_px,center_y_px,contact_radius_px\na.png,10.5,20,8\n")
    assert read_labels(path) == {"a.png": Circle((10.5, 20.0), 8.0)}


def test_what_cannot_be_calibrated_with_is_refused() -> None:
    with pytest.raises(ConfigError, match="no press of the ball"):
        fit_map([], BALL)
    (one,) = touches([(50.0, 50.0)])
    wide = BallPress("wide.png", one.change, one.known, Circle((50.0, 50.0), 40.0))
    with pytest.raises(ConfigError, match=r"wide.png: a contact of radius 2 mm is wider"):
        fit_map([wide], BALL, FitOptions(rounds=0))
    with pytest.raises(ConfigError, match=r"x.png: no ball found; nothing changed"):
        find_circle(image_change(drawn.still(1), drawn.still()), BALL, "x.png")
    with pytest.raises(ConfigError, match="has shape"):
        image_change(drawn.still()[:-4], drawn.still())
    with pytest.raises(ConfigError, match="map=forest is unknown; choose one of mlp"):
        FitOptions("forest")
    with pytest.raises(ConfigError, match="radius_mm=6000"):
        Ball(6000.0, (0.05, 0.05))


def test_an_edge_is_no_ball() -> None:
    """A straight edge pressed across the gel."""
    slope = np.zeros((*drawn.SHAPE, 2))
    slope[44:52, :, 1] = np.linspace(-0.8, 0.8, 8)[:, None]
    with pytest.raises(ConfigError, match=r"edge.png: no ball found; what changed is .* not round"):
        find_circle(image_change(drawn.shaded(slope), drawn.still()), BALL, "edge.png")


def test_calibrations_that_cannot_be_read(tmp_path: Path) -> None:
    path = tmp_path / "calib.npz"
    save_calibration(
        Calibration(SENSOR_MAPS.build("lookup").create(0), drawn.still(), BALL.mm_per_px), path
    )
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(FileError, match=r"calib.npz' cannot be read .*Calibrate again"):
        load_calibration(path)
    np.savez(path, a=np.zeros(3))
    with pytest.raises(FileError, match="damaged or another file"):
        load_calibration(path)
    about = json.dumps({"format": "tactorch-calibration", "version": 9})
    np.savez(path, about=np.array(about))
    with pytest.raises(FileError, match="is of version 9, this tactorch reads 1"):
        load_calibration(path)


def test_a_calibrated_sensor_sees_depth() -> None:
    """From an image alone to heights: the ball's depth, flat around, and where it touches."""
    found, _ = fit_map(touches(CENTERS), BALL, FitOptions(rounds=0))
    sensor = Calibration(found, drawn.still(), BALL.mm_per_px)
    circle = Circle((58.2, 44.7), 17.0)
    seen = reconstruct_height(
        sensor.slopes(drawn.ball(circle.center_px, 17.0, seed=77)), BALL.mm_per_px
    )
    truth = BALL.heights(drawn.SHAPE, circle)
    inside = BALL.distance(drawn.SHAPE, circle) < 0.9
    off = (seen.height_mm - truth)[inside]
    assert off.std() < 0.02
    assert np.abs(seen.height_mm[seen.undeformed]).mean() < 0.01
    assert seen.contact[inside].mean() > 0.85
    assert not seen.contact[BALL.distance(drawn.SHAPE, circle) > 1.6].any()
    still = reconstruct_height(sensor.slopes(drawn.still(5)), BALL.mm_per_px)
    assert not still.contact.any()


@pytest.mark.slow
def test_the_map_that_errs_least_on_presses_left_out_is_chosen() -> None:
    """A few presses in one corner each: a network that knows the place learns it by heart."""
    few = touches([CENTERS[0], CENTERS[4], CENTERS[8]])
    name, found = select_map(few, BALL, FitOptions(rounds=0))
    assert set(found) == {name for name in SENSOR_MAPS.builtin() if SENSOR_MAPS[name].automatic}
    assert name == min(found, key=lambda one: sum(found[one].mae))
    assert found["mlp_colour"].r2 > (0.8, 0.8)
    with pytest.raises(ConfigError, match="folds=3: give 2 to 2"):
        select_map(few[:2], BALL)


def test_maps_of_other_packages_are_no_candidates(monkeypatch: pytest.MonkeyPatch) -> None:
    entries = [EntryPoint("other", "no_such_package_here:Map", "tactorch.sensor_map")]
    monkeypatch.setattr(registry, "entry_points", lambda: entries)
    with pytest.raises(ConfigError, match="no_such_package_here"):
        SENSOR_MAPS.build("other")
    good = MapQuality((0.9, 0.9), (0.1, 0.1), 0.01, 100)
    monkeypatch.setattr(quality, "cross_validate", lambda *_: good)
    _, found = select_map(touches([CENTERS[0], CENTERS[8]]), BALL)
    assert set(found) == {"mlp", "mlp_colour", "lookup"}

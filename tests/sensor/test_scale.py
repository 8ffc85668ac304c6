"""The size of a pixel, from an object of known size: found on images, or from corners by hand."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from tactorch.errors import ConfigError, FileError
from tactorch.sensor.calibration import image_change, marker_pixels
from tactorch.sensor.description import load_sensor, save_sensor
from tactorch.sensor.markers import MarkerAppearance
from tactorch.sensor.scale import (
    KnownShape,
    Outline,
    PixelScale,
    cuboid,
    find_outline,
    fit_warp,
    hexagon,
    measure_pixel_scale,
    read_corners,
)

from . import ball_images as drawn
from . import punch_images as punched

TOLD = punched.sensor()  # 0.06 mm per px, which is not true of what is drawn


def corners_px(
    shape: KnownShape, scale: tuple[float, float], rng: np.random.Generator, noise_px: float = 0.0
) -> np.ndarray:
    """Corners of a shape anywhere, in any order."""
    place = tuple(rng.uniform(-1.0, 1.0, 2))
    seen = punched.sensor(*scale).to_px(punched.rotated(shape.corners, rng.uniform(0, 180), place))
    return rng.permutation(seen + rng.normal(0, noise_px, seen.shape))


@pytest.mark.parametrize(
    ("shape", "heights", "markers", "seeds", "stretch"),
    [
        pytest.param(hexagon(8.0), punched.half_space, False, (1,), 1.2, marks=pytest.mark.slow),
        (hexagon(7.0), punched.decaying, True, (2,), 1.0),
        pytest.param(
            cuboid(9.0, 6.0), punched.decaying, True, (3, 4), 0.95, marks=pytest.mark.slow
        ),
    ],
)
def test_the_scale_is_found_on_images(
    shape: KnownShape, heights: object, markers: bool, seeds: tuple[int, ...], stretch: float
) -> None:
    """Within 0.5 % whatever the gel does beside the punch, and within what is said of it."""
    rng = np.random.default_rng(seeds)
    size = float(rng.uniform(0.058, 0.064))
    true = (size * np.sqrt(stretch), size / np.sqrt(stretch))
    one, look = punched.sensor(*true, markers=markers), MarkerAppearance(9.5) if markers else None
    still, outlines = punched.still(one), []
    for seed in seeds:
        place = tuple(rng.uniform(-1.5, 1.5, 2))
        corners = punched.rotated(shape.corners, rng.uniform(0, 180), place)
        image = punched.image(one, heights(one, corners), seed)
        changed, known = image_change(image, still, look, 0.5), ~marker_pixels(image, still, look)
        outlines.append(find_outline(changed, shape, TOLD.mm_per_px, known, f"{seed}.png"))
        away = np.linalg.norm(outlines[-1].corners_px[:, None] - one.to_px(corners), axis=2)
        assert away.min(axis=0).max() < 0.7
    found = measure_pixel_scale(outlines, shape, TOLD)
    off = np.array(found.mm_per_px) / true - 1
    assert np.abs(off).max() < 0.005
    assert (np.abs(off * true) < 3 * np.array(found.deviation)).all()
    assert found.residual_px < 0.3
    assert list(found.corners_px) == [f"{seed}.png" for seed in seeds]


def test_shapes_have_their_sizes() -> None:
    """A nut's key fits across every pair of flats; a cuboid's sides are as told."""
    corners = hexagon(8.0).corners
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        normal = np.array([b[1] - a[1], a[0] - b[0]]) / np.linalg.norm(b - a)
        assert np.ptp(corners @ normal) == pytest.approx(8.0)
        assert np.linalg.norm(b - a) == pytest.approx(8.0 / np.sqrt(3.0))
    assert np.ptp(cuboid(9.0, 6.0).corners, axis=0) == pytest.approx((9.0, 6.0))
    assert np.rad2deg([hexagon(8.0).symmetry_rad, cuboid(9.0, 6.0).symmetry_rad]) == pytest.approx(
        (60, 180)
    )


@pytest.mark.parametrize("shape", [hexagon(8.0), cuboid(8.0, 8.0), cuboid(9.0, 6.0)])
def test_exact_corners_tell_the_exact_scale(shape: KnownShape, rng: np.random.Generator) -> None:
    """Along x and y each, from one image, whatever the turn and the order."""
    for _ in range(6):
        true = tuple(rng.uniform(0.055, 0.065, 2))
        found = measure_pixel_scale([Outline("a.png", corners_px(shape, true, rng))], shape, TOLD)
        np.testing.assert_allclose(found.mm_per_px, true, rtol=1e-7)
        assert found.residual_px < 1e-5


@pytest.mark.parametrize("turn_deg", [0.0, 90.0, 40.0])
def test_sides_are_told_apart_by_the_shape_of_a_pixel(turn_deg: float) -> None:
    """Seven by six millimetres under pixels that are taller than wide, as the description says."""
    sensor, shape = punched.sensor(0.06, 0.075), cuboid(7.0, 6.0)
    seen = sensor.to_px(punched.rotated(shape.corners, turn_deg, (0.3, -0.2)))
    found = measure_pixel_scale([Outline("a.png", seen)], shape, punched.sensor(0.061, 0.073))
    np.testing.assert_allclose(found.mm_per_px, (0.06, 0.075), rtol=1e-7)


def test_deviations_are_those_of_repeated_measurements(rng: np.random.Generator) -> None:
    true, shape, off = (0.061, 0.058), cuboid(9.0, 6.0), []
    for _ in range(25):
        seen = [Outline(f"{k}", corners_px(shape, true, rng, 0.4), 0.4) for k in range(2)]
        found = measure_pixel_scale(seen, shape, TOLD)
        off.append((np.array(found.mm_per_px) - true) / found.deviation)
        assert 0.2 < found.residual_px < 0.8
    assert 0.7 < np.std(off) < 1.3
    assert np.abs(np.mean(off)) < 0.35


def test_edges_seen_too_far_out_are_a_deviation(rng: np.random.Generator) -> None:
    """All corners half a pixel out look like a larger object; no residual tells."""
    shape, true = cuboid(8.0, 8.0), (0.06, 0.06)
    seen = Outline("a.png", corners_px(shape, true, rng), 0.0, 0.5)
    found = measure_pixel_scale([seen], shape, TOLD)
    half_px = 4.0 / 0.06
    np.testing.assert_allclose(found.deviation, 0.06 * 0.5 / half_px, rtol=1e-3)


def test_disagreement_with_the_description_is_told(tmp_path: Path) -> None:
    true, exact = (0.0588, 0.06), (1e-5, 1e-5)
    found = PixelScale(true, exact, 0.1, {})
    said = found.disagreement(TOLD)
    assert "along x 0.0588 mm per px were measured" in said
    assert "-2.0% of mm_per_px=0.06 in the description of 'punched'" in said
    assert "along y" not in said
    assert PixelScale(true, (1e-3, 1e-3), 0.1, {}).disagreement(TOLD) == ""
    save_sensor(found.apply_to(TOLD), tmp_path / "sensor.yaml")
    again = load_sensor(tmp_path / "sensor.yaml")
    assert again.mm_per_px == true
    assert found.disagreement(again) == ""


@pytest.mark.parametrize("shape", [hexagon(8.0), cuboid(9.0, 6.0)])
def test_a_camera_that_looks_askew(shape: KnownShape, rng: np.random.Generator) -> None:
    """After the warp that is found, distances are the same everywhere; before, they are not."""
    raw = np.array([(14, 9), (309, -6), (330, 246), (-12, 233)], dtype=np.float32)
    square = np.array([(0, 0), (319, 0), (319, 239), (0, 239)], dtype=np.float32)
    askew = cv2.getPerspectiveTransform(square, raw)
    outlines = []
    for k in range(3):
        flat = corners_px(shape, (0.06, 0.06), rng)
        seen = cv2.perspectiveTransform(flat[None], askew)[0]
        outlines.append(Outline(f"{k}.png", seen + rng.normal(0, 0.02, seen.shape)))
    found = fit_warp(outlines, shape, TOLD)
    assert found.residual_px < 0.05
    assert found.deviation_px < 0.5
    sensor = found.apply_to(TOLD)
    assert sensor.mm_per_px == (found.mm_per_px, found.mm_per_px)
    undone = cv2.getPerspectiveTransform(found.corners_px.astype(np.float32), square)
    grid = np.stack(np.meshgrid([0.0, 160.0, 319.0], [0.0, 120.0, 239.0]), axis=-1).reshape(-1, 2)
    bent = cv2.perspectiveTransform(grid[None], askew)
    mapped = cv2.perspectiveTransform(bent, undone)[0]
    true, told = (
        np.linalg.norm(places[:, None] - places, axis=2)[np.triu_indices(9, 1)]
        for places in (grid * 0.06, mapped * found.mm_per_px)
    )
    np.testing.assert_allclose(told, true, rtol=2e-3)
    assert np.ptp(np.linalg.norm(np.diff(bent[0].reshape(3, 3, 2), axis=1), axis=2)) > 5.0


def test_corners_by_hand(tmp_path: Path, rng: np.random.Generator) -> None:
    shape, path = hexagon(8.0), tmp_path / "corners.csv"
    lines = ["image,corner,x_px,y_px"]
    for name in ("a.png", "b.png"):
        seen = corners_px(shape, (0.058, 0.06), rng)
        lines += [f"{name},{k},{x},{y}" for k, (x, y) in enumerate(seen)]
    path.write_text("\n".join(lines))
    found = measure_pixel_scale(list(read_corners(path).values()), shape, TOLD)
    np.testing.assert_allclose(found.mm_per_px, (0.058, 0.06), rtol=1e-6)
    assert found.deviation[0] > 1e-4  # half a pixel of what is set by hand
    assert set(found.corners_px) == {"a.png", "b.png"}


HEAD = "image,corner,x_px,y_px\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("image,corner,x_px\na,1,2\n", "lacks the column y_px; it needs image, corner, x_px, y_px"),
        (HEAD, "has no line"),
        (HEAD + "a.png,1,10,ten\n", "line 2: could not convert"),
        (HEAD + "a.png,1,10,\n", "line 2: y_px is missing"),
        (HEAD + "a.png,1,10,10\na.png,1,90,10\n", "line 3: corner 1 of a.png is given twice"),
        (HEAD + "a.png,1,10,10\na.png,2,90,10\n", "a.png: give three corners or more"),
        (HEAD + "a.png,1,1,1\na.png,2,50,50\na.png,3,90,90\n", "a.png: .* is on a line"),
        (HEAD + "a.png,1,1,1\na.png,2,90,1\na.png,3,90,90\na.png,4,91,90\n", "two corners are at"),
    ],
)
def test_tables_of_corners_that_cannot_be_read(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "corners.csv"
    path.write_text(text)
    with pytest.raises((FileError, ConfigError), match=message) as caught:
        read_corners(path)
    assert "corners.csv" in str(caught.value)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: hexagon(0.0), "across_flats_mm=0.0 must be a positive number"),
        (lambda: hexagon(0.008), "0.008 looks like metres; give 8"),
        (lambda: cuboid(8.0, -1.0), "height_mm=-1.0 must be a positive"),
        (lambda: cuboid(800.0, 8.0), "width_mm=800: give mm, up to 200"),
    ],
)
def test_sizes_that_are_none(make: object, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        make()


def test_corners_that_tell_no_scale(rng: np.random.Generator) -> None:
    shape, true = cuboid(9.0, 6.0), (0.06, 0.06)
    good = [Outline(f"{k}.png", corners_px(shape, true, rng)) for k in range(3)]
    other = Outline("other.png", corners_px(shape, (0.064, 0.064), rng))
    six = Outline("six.png", corners_px(hexagon(8.0), true, rng))
    askew = Outline("askew.png", np.array([(50, 50), (200, 60), (170, 160), (60, 150)], float))
    beside = Outline("beside.png", good[0].corners_px + np.array([250.0, 0.0]))
    wide = Outline("wide.png", np.array([(50, 50), (200, 50), (200, 90), (50, 90)], float))
    for outlines, message in (
        ([], "no image of a known shape"),
        ([six], "six.png: 6 corners, but a cuboid has 4"),
        ([*good, other], r"images disagree: other.png gives 0.064 x 0.064 mm per px, the median"),
        ([*good, askew], r"askew.png: its corners are no cuboid of that size, but \d.* px off"),
        ([beside], r"beside.png: the corner at .* is outside the image of 320 x 240 px"),
        ([wide], "wide.png: a pixel would be .* check the sizes"),
    ):
        with pytest.raises(ConfigError, match=message):
            measure_pixel_scale(outlines, shape, TOLD)


def test_warps_that_cannot_be_found(rng: np.random.Generator) -> None:
    shape = cuboid(9.0, 6.0)
    one = Outline("a.png", corners_px(shape, (0.06, 0.06), rng))
    two = Outline("b.png", corners_px(cuboid(9.0, 9.0), (0.06, 0.06), rng))
    with pytest.raises(ConfigError, match="a cuboid in 1 image is not enough"):
        fit_warp([one], shape, TOLD)
    with pytest.raises(ConfigError, match="no image of a known shape"):
        fit_warp([], shape, TOLD)
    with pytest.raises(ConfigError, match="its corners are no cuboid of that size from any"):
        fit_warp([one, two], shape, TOLD)
    three = [Outline(f"{k}.png", corners_px(shape, (0.06, 0.06), rng)) for k in range(3)]
    with pytest.raises(ConfigError, match="'punched' has warp_corners_px or crop_px already"):
        fit_warp([one], shape, fit_warp(three, shape, TOLD).apply_to(TOLD))


def test_images_without_the_shape() -> None:
    scale = (drawn.MM_PER_PX, drawn.MM_PER_PX)
    with pytest.raises(ConfigError, match=r"a.png: no hexagon found; nothing changed"):
        find_outline(image_change(drawn.still(1), drawn.still()), hexagon(2.0), scale, name="a.png")
    ball = image_change(drawn.ball((52.0, 47.0), 24.0), drawn.still(), smooth_px=0.5)
    with pytest.raises(ConfigError, match=r"ball.png: no cuboid found; .* by hand"):
        find_outline(ball, cuboid(2.0, 2.0), scale, name="ball.png")
    with pytest.raises(ConfigError, match=r"ball.png: no cuboid found; none of its size fits"):
        find_outline(ball, cuboid(40.0, 40.0), scale, name="ball.png")

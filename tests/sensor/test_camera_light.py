"""Light and height by gradients through the camera, on images drawn without the camera's code."""

from pathlib import Path

import numpy as np
import pytest
import torch

from tactorch.errors import ConfigError, FileError
from tactorch.sensor.calibration import (
    SENSOR_MAPS,
    Ball,
    BallPress,
    Calibration,
    Circle,
    FitOptions,
    evaluate_map,
    fit_map,
    image_change,
    load_calibration,
    save_calibration,
)
from tactorch.sensor.calibration.camera import CameraLight, CameraMap
from tactorch.sensor.calibration.fit import fit_to_contacts
from tactorch.sensor.calibration.maps import map_slopes
from tactorch.sensor.camera import HeightFitOptions, Shading, fit_height, fit_light

from . import ball_images

CENTERS = [(55.0, 48.0), (35.0, 30.0), (75.0, 66.0), (76.0, 32.0), (34.0, 64.0), (55.0, 30.0)]
BALL = Ball(ball_images.RADIUS_MM, (ball_images.MM_PER_PX,) * 2)
REFERENCE = ball_images.still()


def press(center: tuple[float, float], seed: int = 1) -> BallPress:
    change = image_change(ball_images.ball(center, seed=seed), REFERENCE)
    return BallPress(f"{center}", change, np.ones(change.shape[:2], bool), Circle(center, 18.0))


@pytest.fixture(scope="module")
def presses() -> list[BallPress]:
    return [press(center, seed) for seed, center in enumerate(CENTERS)]


@pytest.fixture(scope="module")
def fitted(presses: list[BallPress]) -> CameraMap:
    lookup = SENSOR_MAPS.build("lookup").create(0)
    found, _ = fit_map(presses, BALL, FitOptions("lookup", rounds=0))
    assert type(found) is type(lookup)
    result = fit_to_contacts(CameraLight(), presses, found, BALL)
    assert isinstance(result, CameraMap)
    return result


def true_height(center: tuple[float, float]) -> np.ndarray:
    """Height of the drawn face, by its slopes outward from the contact."""
    slopes = ball_images.slopes(center, 18.0)
    from tactorch.sensor.depth import integrate_slopes

    y, x = np.mgrid[: ball_images.SHAPE[0], : ball_images.SHAPE[1]]
    far = np.hypot(x - center[0], y - center[1]) > 45
    return integrate_slopes(slopes[..., 0], slopes[..., 1], BALL.mm_per_px, zero=far)


def test_slopes_are_those_of_a_press_left_out(fitted: CameraMap) -> None:
    quality = evaluate_map(fitted, [press((60.0, 55.0), seed=20)], BALL)
    assert min(quality.r2) > 0.95
    assert quality.flat_slope < 0.05
    assert fitted.light is not None
    assert fitted.light.deviation < 0.05  # 2.5 gray values: the noise of the images is 1.5


def test_the_light_is_recovered_from_its_own_colours(rng: np.random.Generator) -> None:
    true = Shading((10.0, 130.0, 250.0), 30.0, np.diag([150.0, 140.0, 130.0]).tolist(), (50.0,) * 3)
    slopes, places = rng.normal(0, 0.4, (4000, 2)), rng.uniform(-1, 1, (4000, 2))
    with torch.no_grad():
        change = true.change(torch.from_numpy(slopes), torch.from_numpy(places)).numpy()
    light = fit_light(change, slopes, places)
    assert light.deviation < 0.02  # a gray value, of 35 that the slopes change
    azimuths = np.rad2deg(light.shading.azimuth.detach().numpy())
    np.testing.assert_allclose((azimuths - (10, 130, 250) + 180) % 360 - 180, 0, atol=12.0)


def test_fitted_heights_are_better_than_those_of_a_coarse_lookup(
    presses: list[BallPress], fitted: CameraMap
) -> None:
    found, _ = fit_map(presses, BALL, FitOptions("lookup", rounds=0))
    calibration = Calibration(found, REFERENCE, BALL.mm_per_px, light=fitted.light)
    image, true = ball_images.ball((60.0, 55.0), seed=21), true_height((60.0, 55.0))
    errors = {}
    for depth in ("lookup", "fit"):
        height = calibration.height(image, depth=depth)
        assert height.contact[55, 60]
        errors[depth] = float(np.sqrt(np.mean((height.height_mm - true) ** 2)))
    assert errors["fit"] < errors["lookup"]
    assert errors["fit"] < 0.05 * -true.min()


def test_three_steps_fit_a_height(presses: list[BallPress], fitted: CameraMap) -> None:
    """With the whole curvature of the cost; without part of it more steps reach the minimum."""
    found, _ = fit_map(presses, BALL, FitOptions("lookup", rounds=0))
    image = ball_images.ball((60.0, 55.0))
    start = Calibration(found, REFERENCE, BALL.mm_per_px).height(image)
    change, light = image_change(image, REFERENCE), fitted.light
    assert light is not None
    heights = [
        fit_height(
            change, light.shading, light.deviation, map_slopes(found, change), start,
            BALL.mm_per_px, HeightFitOptions(iterations=steps),
        ).height_mm
        for steps in (3, 30)
    ]  # fmt: skip
    assert np.abs(heights[0] - heights[1]).max() < 0.005 * start.depth_mm


def test_the_light_is_stored_with_a_calibration(fitted: CameraMap, tmp_path: Path) -> None:
    path = tmp_path / "calib.npz"
    save_calibration(Calibration(fitted, REFERENCE, BALL.mm_per_px, light=fitted.light), path)
    again = load_calibration(path)
    assert again.map_name == "camera"
    features = np.random.default_rng(0).uniform(-0.5, 0.5, (50, 5))
    np.testing.assert_array_equal(again.map(features), fitted(features))
    assert again.light is not None
    assert again.light.deviation == fitted.light.deviation
    with np.load(path) as archive:
        arrays = dict(archive)
    arrays["camera/gamma"] = np.ones(5)
    np.savez(path, **arrays)
    with pytest.raises(FileError, match="cannot be read"):
        load_calibration(path)


def test_what_is_missing_is_told(fitted: CameraMap) -> None:
    with pytest.raises(ConfigError, match="no light yet"):
        CameraMap(CameraLight()).arrays()
    with pytest.raises(ConfigError, match="10 pixels are too few"):
        fit_light(np.zeros((10, 3)), np.zeros((10, 2)), np.zeros((10, 2)))
    calibration = Calibration(fitted, REFERENCE, BALL.mm_per_px)
    with pytest.raises(ConfigError, match="calibrate again with camera=true"):
        calibration.height(REFERENCE, depth="fit")


def test_an_automatic_selection_leaves_the_camera_out() -> None:
    automatic = [name for name in SENSOR_MAPS.names() if SENSOR_MAPS.build(name).automatic]
    assert automatic == ["mlp", "mlp_colour", "lookup"]

"""A change of the light between reference and frame is removed, or reported."""

from collections.abc import Callable

import numpy as np
import pytest

from tactorch.sensor.calibration import Ball, BallPress, Calibration, Circle, FitOptions, fit_map
from tactorch.sensor.calibration.maps import Lookup, image_change
from tactorch.sensor.depth import HeightMap

from . import ball_images as drawn

EDGES = (14.0, 16.0, 18.0, 20.0)
Y, X = np.mgrid[-1 : 1 : 96 * 1j, -1 : 1 : 110 * 1j][..., None]


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    size = (drawn.MM_PER_PX, drawn.MM_PER_PX)
    places = [(40.0, 40.0), (70.0, 40.0), (40.0, 58.0), (70.0, 58.0)]
    presses = [
        BallPress(
            str(k), image_change(drawn.ball(place, edge, seed=k), drawn.still()),
            np.ones(drawn.SHAPE, dtype=bool), Circle(place, edge), labeled=True,
        )
        for k, (place, edge) in enumerate(zip(places, EDGES, strict=True))
    ]  # fmt: skip
    slope_map, _ = fit_map(presses, Ball(drawn.RADIUS_MM, size), FitOptions(Lookup(), rounds=0))
    return Calibration(slope_map, drawn.still(), size)


def height(calibration: Calibration, change: Callable, contact_px: float = 15.0) -> HeightMap:
    image = drawn.ball((55.0, 48.0), contact_px).astype(float)
    return calibration.height(np.clip(change(image), 0, 255).astype(np.uint8))


@pytest.fixture(scope="module")
def depth_mm(calibration: Calibration) -> float:
    found = height(calibration, lambda image: image)
    assert found.light is not None
    assert not found.light.changed
    assert found.light.fault == ""
    return found.depth_mm


@pytest.mark.parametrize(
    "change",
    [
        *(pytest.param(lambda image, f=f: f * image, id=f"factor {f}") for f in (0.6, 0.9, 0.95)),
        *(pytest.param(lambda image, f=f: f * image, id=f"factor {f}") for f in (1.05, 1.1)),
        pytest.param(lambda image: image * (1.1, 1.0, 0.9), id="white balance"),
        pytest.param(lambda image: image * (0.8, 1.0, 1.0), id="one lamp"),
        pytest.param(lambda image: image + 10.0, id="light of the room"),
        pytest.param(lambda image: image - (12.0, 8.0, 2.0), id="light of the room, coloured"),
        pytest.param(lambda image: image * (1 + 0.08 * X), id="to one side"),
        pytest.param(lambda image: image * (1.05 - 0.1 * (X**2 + Y**2)), id="vignetting"),
    ],
)
def test_depth_does_not_depend_on_the_light(
    calibration: Calibration, depth_mm: float, change: Callable
) -> None:
    found = height(calibration, change)
    assert found.depth_mm == pytest.approx(depth_mm, rel=0.015)
    assert found.light is not None
    assert found.light.fault == ""


@pytest.mark.parametrize("factor", [0.98, 1.02])
def test_a_slight_change_is_corrected_or_counted(
    calibration: Calibration, depth_mm: float, factor: float
) -> None:
    found = height(calibration, lambda image: factor * image)
    assert abs(found.depth_mm - depth_mm) < 0.01 * depth_mm + 1.5 * found.light_error_mm


def test_a_factor_is_reported(calibration: Calibration) -> None:
    light = height(calibration, lambda image: image * (0.9, 0.95, 1.0)).light
    assert light is not None
    assert light.changed
    np.testing.assert_allclose(1 + light.terms[:, 0], (0.9, 0.95, 1.0), atol=0.01)
    assert light.factor == pytest.approx(0.95, abs=0.01)


@pytest.mark.parametrize("gamma", [0.7, 0.8, 0.85, 1.15, 1.3, 1.5])
def test_another_gamma_is_a_fault(calibration: Calibration, depth_mm: float, gamma: float) -> None:
    found = height(calibration, lambda image: 255 * (image / 255) ** gamma)
    assert abs(found.depth_mm - depth_mm) < 2.0 * found.light_error_mm
    assert found.light is not None
    assert found.light.fault.startswith("light not known")


def test_a_contact_over_the_whole_image_is_a_fault(calibration: Calibration) -> None:
    slope = 0.05 * drawn.slopes((55.0, 48.0), 29.0)
    slope = np.stack(
        [0.6 * X[..., 0] + 0 * slope[..., 0], 0.6 * Y[..., 0] + 0 * X[..., 0]], axis=-1
    )
    light = calibration.height(drawn.shaded(slope, seed=3)).light
    assert light is not None
    assert light.fault.startswith("light not known")
    white = np.full((*drawn.SHAPE, 3), 255, dtype=np.uint8)
    light = calibration.height(white).light
    assert light is not None
    assert light.share == 0.0
    assert light.fault

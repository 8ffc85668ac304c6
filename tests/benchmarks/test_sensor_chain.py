"""The chain from images to a map."""

import json
from types import ModuleType

import numpy as np
import pytest

NAME = "sensor_chain"


@pytest.mark.slow
def test_gel_and_cube_share_what_touches(benchmark: ModuleType) -> None:
    (scene,) = benchmark.simulated(benchmark.SIDES["z+"], 1.0, [1.0])
    assert scene.force[2] < -1.0  # N: the cube pushes the gel into the sensor
    under = np.abs(scene.points[:, :2]).max(axis=1) < 4.1
    beside = np.abs(scene.points[:, :2]).max(axis=1) > 6.1
    assert scene.moved[under, 2].max() < 2 * scene.moved[beside, 2].min()  # both below 0
    assert scene.cube[..., 2].min() > -1.0


def test_sides_are_turned_up(benchmark: ModuleType) -> None:
    for name, turn in benchmark.SIDES.items():
        out = np.eye(3)["xyz".index(name[0])]
        np.testing.assert_allclose(turn @ out, (0, 0, 1))
        assert np.linalg.det(turn) == pytest.approx(1.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    "simulation",
    [
        [],
        pytest.param(
            ["--cell", "1.0", "--element", "tet10"],
            marks=pytest.mark.xfail(
                reason="11 % too much force, the ball 2.1 mm off: see the docs"
            ),
        ),
    ],
)
def test_a_ball_is_found_from_images_alone(
    benchmark: ModuleType, capsys: pytest.CaptureFixture[str], simulation: list[str]
) -> None:
    """Laterally within 1.5 mm in a cube of 10 mm, and far better."""
    benchmark.main(simulation)
    found = json.loads(capsys.readouterr().out.strip().splitlines()[-1])
    assert min(found["calibration"]["r2"]) > 0.98
    assert found["calibration"]["depth_rms_mm"] < 0.05
    for side in found["presses"]:
        assert side["marker_rms_mm"] < 0.01
        assert side["force_n"] == pytest.approx(side["true_force_n"], rel=0.1)
        assert side["object_rms_mm"] < 0.1 * side["object_size_mm"]
    assert found["map"]["off_mm"] < 1.0
    assert found["map"]["hardest_mpa"] > 1.5 * found["map"]["soft_mpa"]

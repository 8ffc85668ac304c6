"""The chain from images to a map."""

import json
from types import ModuleType

import numpy as np
import pytest

from tactorch.sensor.frames import read_frames
from tactorch.sensor.render import GelSurface, RenderOptions, render

NAME = "sensor_chain"


@pytest.mark.slow
def test_gel_and_cube_share_what_touches(benchmark: ModuleType) -> None:
    session = benchmark.SESSIONS["main"]
    _, deep = benchmark.simulated(session, benchmark.SIDES["z+"], 3.0)
    assert deep.force[2] == pytest.approx(-1.83, rel=0.03)  # N; -1.834 with edges of 0.5 mm
    points, moved = benchmark.gel_face(deep, session, session.depths_mm[1])
    under = np.abs(points[:, :2]).max(axis=1) < 4.1
    beside = np.abs(points[:, :2]).max(axis=1) > 6.1
    assert moved[under, 2].max() < 2 * moved[beside, 2].min()  # both below 0
    assert deep.displacement[:, 2].min() > -1.0


def test_sides_are_turned_up(benchmark: ModuleType) -> None:
    for name, turn in benchmark.SIDES.items():
        out = np.eye(3)["xyz".index(name[0])]
        np.testing.assert_allclose(turn @ out, (0, 0, 1))
        assert np.linalg.det(turn) == pytest.approx(1.0)


def test_photographs_show_the_face_once_they_are_rectified(benchmark: ModuleType) -> None:
    sensor = benchmark.SENSOR
    rows, columns = np.indices(sensor.shape)
    bump = -0.4 * np.exp(-((columns - 120.0) ** 2 + (rows - 180.0) ** 2) / 2000.0)
    face = GelSurface(bump, sensor.to_px(sensor.markers.positions_mm))
    raw = benchmark.photographed(face, seed=1)
    assert raw.shape[:2] == sensor.raw_size_px[::-1]
    unmoved = render(sensor, GelSurface(0.0 * bump, face.markers_px), RenderOptions(noise=0.0))
    (frame,) = read_frames([raw], sensor, unmoved)
    ideal = render(sensor, face, RenderOptions(noise=0.0)).astype(float)
    away = np.abs(frame.image - ideal)
    assert np.median(away) < 2.0
    assert away.mean() < 3.0  # pixels at the edges of markers are interpolated twice
    unmoved = render(sensor, GelSurface(0.0 * bump, face.markers_px), RenderOptions(noise=0.0))
    steep = np.hypot(*np.gradient(bump)) > 0.005
    change = np.abs(ideal - unmoved.astype(float))
    assert change[steep].mean() > 3.0 * away[steep].mean()


@pytest.mark.slow
def test_a_ball_is_found_from_images_alone(
    benchmark: ModuleType, capsys: pytest.CaptureFixture[str]
) -> None:
    benchmark.main([])
    (found,) = json.loads(capsys.readouterr().out.strip().splitlines()[-1]).values()
    assert min(found["calibration"]["r2"]) > 0.98
    assert found["calibration"]["depth_rms_mm"] < 0.05
    for side in found["presses"]:
        assert side["marker_rms_mm"] < 0.01
        assert side["force_n"] == pytest.approx(side["true_force_n"], rel=0.03)
        assert side["object_rms_mm"] < 0.1 * side["object_size_mm"]
    assert found["map"]["inclusions"] == 1
    assert found["map"]["off_mm"] < 0.7
    assert np.hypot(*found["map"]["off_axes_mm"][:2]) < 0.5
    assert found["map"]["within"]


def test_wrong_poses_are_off_by_what_is_stated(benchmark: ModuleType) -> None:
    off = benchmark.misplacement(np.random.default_rng(0))
    assert np.linalg.norm(off[:3, 3]) == pytest.approx(benchmark.OFF_MM)
    turn = np.arccos((np.trace(off[:3, :3]) - 1.0) / 2.0)
    assert np.rad2deg(turn) == pytest.approx(benchmark.OFF_DEG)

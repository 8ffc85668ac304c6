"""Pictures of a sensor's frames: what is drawn is what was given, where it is."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from tactorch.errors import FileError
from tactorch.mesh.geometry import vertex_areas
from tactorch.sensor.calibration import Ball, BallPress, Circle
from tactorch.sensor.description import GelLayer, SensorDescription
from tactorch.viz import save_figure
from tactorch.viz.sensor_calibration import PlottedPress, ball_press_figure
from tactorch.viz.sensor_frames import (
    DepthView,
    ForceView,
    MarkerView,
    colour_limit,
    faded,
    image_extent,
    render,
)
from tactorch.viz.session import over_time_figure
from tactorch.viz.video import video_suffix, writing_video

SENSOR = SensorDescription("s", (60, 40), (0.2, 0.25), GelLayer(3.0, 0.2, size_mm=(12.0, 10.0)))
IMAGE = np.random.default_rng(0).integers(0, 255, (40, 60, 3), dtype=np.uint8)


def test_axes_are_in_mm_and_y_points_down() -> None:
    left, right, bottom, top = image_extent(SENSOR)
    assert (left, right) == pytest.approx((-6.0, 6.0))
    assert (bottom, top) == pytest.approx((5.0, -5.0))


def test_faded_images_are_light_and_keep_their_order() -> None:
    light = faded(IMAGE)
    assert light.min() >= 110
    assert (light[..., 0] == light[..., 2]).all()
    grey = IMAGE.mean(axis=2)
    assert np.corrcoef(grey.ravel(), light[..., 0].ravel())[0, 1] > 0.95


def test_a_lone_outlier_does_not_stretch_colours() -> None:
    values = np.append(np.linspace(0.0, 1.0, 20_000), [1e6, np.nan])
    assert colour_limit(values, 0.05) == pytest.approx(1.0, rel=0.01)
    assert colour_limit(np.full(3, np.nan), 0.05) == 0.05


def test_arrows_are_as_markers_moved_and_lost_ones_are_marked() -> None:
    begin = np.array([[10.0, 10.0], [30.0, 20.0], [50.0, 30.0]])
    view = MarkerView(SENSOR, begin, 1.0, magnify=2.0)
    places = begin + np.array([[2.0, 0.0], [0.0, -1.0], [np.nan, np.nan]])
    view.show(IMAGE, places, "caption")
    arrows = view._arrows
    np.testing.assert_allclose(arrows.get_offsets(), SENSOR.to_mm(begin))
    np.testing.assert_allclose(np.ma.compressed(arrows.U[:2]), (0.4, 0.0), atol=1e-12)
    np.testing.assert_allclose(np.ma.compressed(arrows.V[:2]), (0.0, -0.25), atol=1e-12)
    np.testing.assert_allclose(arrows.get_array()[:2], (0.4, 0.25))
    assert arrows.scale == 0.5  # data units of an arrow: twice as long
    assert np.asarray(arrows.Umask)[2]
    np.testing.assert_allclose(np.transpose(view._lost.get_data()), SENSOR.to_mm(begin[2:]))
    assert view._title.get_text() == "caption"
    seen = render(view.figure)
    assert seen.shape[0] % 2 == seen.shape[1] % 2 == 0
    view.show(None, np.full((3, 2), np.nan), "none")
    assert (render(view.figure) != seen).any()


def test_depth_is_what_is_pressed_in() -> None:
    view = DepthView(SENSOR, 0.8)
    height = np.zeros(SENSOR.shape)
    height[10:20, 30:40] = -0.8
    view.show(IMAGE, height, height < -0.4, "caption")
    drawn = np.asarray(view._depth.get_array())
    np.testing.assert_allclose(drawn, -height)
    assert view._depth.get_clim() == (0.0, 0.8)
    (outline,) = {
        line.get_paths()[0].get_extents().extents.round(6).tobytes() for line in view._outlines
    }
    x0, y0, x1, y1 = np.frombuffer(outline)
    assert (x0, x1) == pytest.approx((0.0, 2.0), abs=0.2)  # columns 30 to 40
    assert (y0, y1) == pytest.approx((-2.5, 0.0), abs=0.25)  # rows 10 to 20
    view.show(IMAGE, np.full(SENSOR.shape, np.nan), np.zeros(SENSOR.shape, dtype=bool), "none")
    assert not view._outlines
    assert np.ma.getmaskarray(view._depth.get_array()).all()


def grid() -> tuple[np.ndarray, np.ndarray]:
    x, y = np.meshgrid(np.linspace(-6, 6, 7), np.linspace(-5, 5, 6))
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    cells = np.arange(42).reshape(6, 7)
    a, b, c, d = cells[:-1, :-1], cells[:-1, 1:], cells[1:, :-1], cells[1:, 1:]
    halves = (np.stack([a, b, d], axis=-1), np.stack([a, d, c], axis=-1))
    return points, np.concatenate([half.reshape(-1, 3) for half in halves])


def test_an_even_pressure_is_drawn_even() -> None:
    """Forces are by node, and a node at the edge has less area: pressure does not show it."""
    points, triangles = grid()
    area = vertex_areas(points, triangles)
    assert area.sum() == pytest.approx(120.0)
    forces = area[:, None] * np.array([0.002, 0.0, -0.01])  # MPa
    view = ForceView(SENSOR, points, triangles, (0.01, 0.002))
    view.show(IMAGE, forces, "caption")
    np.testing.assert_allclose(view._mesh.get_array(), 10.0)  # kPa, of a push into the gel
    assert view._mesh.get_clim() == (0.0, 10.0)
    np.testing.assert_allclose(view._arrows.U, 2.0)
    np.testing.assert_allclose(view._arrows.V, 0.0, atol=1e-12)
    view.show(IMAGE, None, "none")
    np.testing.assert_allclose(view._mesh.get_array(), 0.0)
    assert np.asarray(view._arrows.Umask).all()


@pytest.mark.slow
def test_presses_are_drawn_beside_the_ball(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ball, circle = Ball(2.0, (0.1, 0.1)), Circle((30.0, 20.0), 10.0)
    slopes, height = ball.slopes((40, 60), circle), ball.heights((40, 60), circle)
    known = np.ones((40, 60), dtype=bool)
    touched = BallPress("p.png", np.zeros(IMAGE.shape), known, circle, circle)
    press = PlottedPress(touched, IMAGE, ball, slopes, height)
    monkeypatch.setattr("tactorch.viz.sensor_calibration._MAX_PRESSES", 2)
    one = save_figure(ball_press_figure([press], "title"), tmp_path / "one.png")
    many = save_figure(ball_press_figure([press] * 12, "title"), tmp_path / "many.png")
    sizes = [cv2.imread(str(path)).shape for path in (one, many)]
    assert 1.7 < sizes[1][0] / sizes[0][0] < 2.0  # two rows of twelve


def test_measures_over_time(tmp_path: Path) -> None:
    panels = {"force, N": {"x": np.array([0.0, np.nan, 1.0])}, "depth, mm": {"d": np.ones(3)}}
    for name, times in (("a.png", None), ("b.png", np.array([0.0, 0.1, 0.3]))):
        figure = over_time_figure(panels, times, [1])
        assert save_figure(figure, tmp_path / name).stat().st_size > 5000


def frames(count: int) -> list[np.ndarray]:
    return [np.full((48, 64, 3), 20 * k, np.uint8) for k in range(count)]


def test_videos_have_all_frames_in_colour_and_time(tmp_path: Path) -> None:
    path = tmp_path / f"v{video_suffix()}"
    red = [np.full((48, 64, 3), (200, 30, 30), np.uint8) for _ in range(6)]
    with writing_video(path, 12.5) as add:
        for image in red:
            add(image)
    capture = cv2.VideoCapture(str(path))
    assert capture.get(cv2.CAP_PROP_FPS) == pytest.approx(12.5, rel=0.02)
    found = []
    while (shot := capture.read())[0]:
        found.append(shot[1])
    assert len(found) == 6
    np.testing.assert_allclose(found[3].mean(axis=(0, 1))[::-1], (200, 30, 30), atol=12)


def test_a_video_that_is_stopped_is_not_there(tmp_path: Path) -> None:
    path = tmp_path / f"v{video_suffix()}"

    def stopped() -> None:
        with writing_video(path, 10.0) as add:
            add(frames(1)[0])
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stopped()
    assert not list(tmp_path.iterdir())
    with pytest.raises(FileError, match="has no image"), writing_video(path, 10.0):
        pass
    with pytest.raises(FileError, match=r"no codec for \.gif"), writing_video("x.gif", 10.0) as add:
        add(frames(1)[0])
    assert not list(tmp_path.iterdir())


def test_without_a_codec_there_is_no_video(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tactorch.viz.video._CODECS", ())
    assert video_suffix() is None

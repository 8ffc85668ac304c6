"""The simulated sensor: what is drawn is what was pressed."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from tactorch.errors import ConfigError
from tactorch.sensor.description import GelLayer, MarkerGrid, SensorDescription
from tactorch.sensor.markers import MarkerAppearance, MarkerTracker
from tactorch.sensor.render import GelSurface, Lamps, RenderOptions, build_surface, render

GEL = GelLayer(4.0, 0.2, 0.45, size_mm=(18.0, 14.0))
SENSOR = SensorDescription(
    "drawn", (180, 140), (0.1, 0.1), GEL, MarkerGrid(7, 5, (2.4, 2.4), 0.6)
)  # fmt: skip
BARE = SensorDescription("bare", (180, 140), (0.1, 0.1), GEL)


def face_nodes() -> np.ndarray:
    x, y = np.meshgrid(np.linspace(-9, 9, 37), np.linspace(-7, 7, 29))
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])


def press(points: np.ndarray, depth_mm: float) -> np.ndarray:
    """A smooth dent that spreads the face a little."""
    x, y = points[:, 0] - 1.0, points[:, 1] + 0.5
    size = depth_mm * np.exp(-(x**2 + y**2) / 8.0)
    return np.column_stack([0.12 * x * size, 0.12 * y * size + 0.1 * size, -size])


def mean_colour(image: np.ndarray, x_mm: float, y_mm: float) -> np.ndarray:
    column, row = BARE.to_px(np.array([x_mm, y_mm])).round().astype(int)
    return image[row - 3 : row + 4, column - 3 : column + 4].reshape(-1, 3).mean(axis=0)


def test_the_face_is_where_its_nodes_went() -> None:
    points = face_nodes()
    moved = press(points, 1.0)
    face = build_surface(BARE, points, moved)
    deepest = np.unravel_index(face.height_mm.argmin(), face.height_mm.shape)
    np.testing.assert_allclose(BARE.to_mm(np.array(deepest[::-1], float)), (1.0, -0.4), atol=0.2)
    assert face.height_mm.min() == pytest.approx(-1.0, abs=0.03)
    still = build_surface(SENSOR, points, np.zeros_like(points))
    np.testing.assert_allclose(still.height_mm, 0.0, atol=1e-12)
    np.testing.assert_allclose(
        SENSOR.to_mm(still.markers_px), SENSOR.markers.positions_mm, atol=1e-9
    )


def test_a_side_that_faces_a_lamp_is_lit_by_it() -> None:
    """Red stands on the right. Seen from within, a dent is a bump: its right side faces red."""
    face = build_surface(BARE, face_nodes(), press(face_nodes(), 1.0))
    lit = render(BARE, face, RenderOptions(Lamps(falloff=0.0), noise=0.0))
    level = mean_colour(lit, -7.0, 5.5)
    assert mean_colour(lit, 3.0, -0.5)[0] > level[0] + 15
    assert mean_colour(lit, -1.0, -0.5)[0] < level[0] - 15


def test_a_steep_bump_throws_a_shadow() -> None:
    height = np.zeros(BARE.shape)
    height[60:80, 85:95] = -1.5
    lamp = {"azimuths_deg": (0.0,), "colours": ((200, 200, 200),), "falloff": 0.0}
    lit, unshaded = (
        render(
            BARE,
            GelSurface(height, np.zeros((0, 2))),
            RenderOptions(Lamps(**lamp, shadow=s), noise=0.0),
        )
        for s in (0.8, 0.0)
    )
    darker = unshaded.astype(int) - lit
    assert darker[70, 70:84].max() > 50  # away from the lamp, which stands on the right
    assert darker[70, 100:].max() == 0


def test_markers_are_followed_as_they_were_moved() -> None:
    """Median within 0.1 px and 95 % within 0.5 px of how the gel was moved."""
    points = face_nodes()
    faces = [
        build_surface(SENSOR, points, press(points, depth)) for depth in (0.0, 0.3, 0.6, 0.9, 1.2)
    ]
    images = [
        render(SENSOR, face, RenderOptions(noise=2.0), seed=i) for i, face in enumerate(faces)
    ]
    tracker = MarkerTracker(images[0], MarkerAppearance(6.0))
    order = cKDTree(faces[0].markers_px).query(tracker.reference_px)[1]
    assert len(set(order)) == 35
    off = []
    for face, image in zip(faces[1:], images[1:], strict=True):
        found = tracker.track(image)
        true = (face.markers_px - faces[0].markers_px)[order]
        valid = np.isfinite(found[:, 0])
        off.append(np.linalg.norm(found - tracker.reference_px - true, axis=1)[valid])
        assert valid.mean() > 0.9
    assert np.median(np.concatenate(off)) < 0.1
    assert np.percentile(np.concatenate(off), 95) < 0.5


def test_noise_has_a_seed() -> None:
    face = GelSurface(np.zeros(BARE.shape), np.zeros((0, 2)))
    one, same, other, clean = (render(BARE, face, seed=seed) for seed in (1, 1, 2, None))
    np.testing.assert_array_equal(one, same)
    assert (one != other).any()
    assert 1.0 < (one.astype(float) - clean).std() < 2.0


def test_wrong_input_is_refused() -> None:
    with pytest.raises(ConfigError, match="heights are"):
        render(BARE, GelSurface(np.zeros((4, 4)), np.zeros((0, 2))))
    with pytest.raises(ConfigError, match=r"one colour for each lamp"):
        Lamps(azimuths_deg=(0.0,))
    with pytest.raises(ConfigError, match="elevation_deg=95"):
        Lamps(elevation_deg=95.0)
    with pytest.raises(ConfigError, match="shadow=2"):
        Lamps(shadow=2.0)
    with pytest.raises(ConfigError, match="noise=-1"):
        RenderOptions(noise=-1.0)

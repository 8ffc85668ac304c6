"""The size of a pixel of a real sensor, with corners that others published: `-m external`.

Its image of a printed cuboid has no reference, and the cuboid's edges are bands of some 10 px; the
published corners lie in their middle, and go into the homography that was published with them.
"""

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from tactorch.errors import ConfigError
from tactorch.sensor.calibration import image_change, marker_pixels
from tactorch.sensor.description import load_sensor
from tactorch.sensor.frames import read_image
from tactorch.sensor.markers import MarkerAppearance
from tactorch.sensor.scale import Outline, cuboid, find_outline, measure_pixel_scale, read_corners

pytestmark = pytest.mark.external

SHAPE = cuboid(10.0, 10.0)


@pytest.fixture(scope="module")
def folder(shared_data: Path) -> Path:
    return shared_data / "feats-mini-gel"


@pytest.fixture(scope="module")
def outline(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Outline:
    published = yaml.safe_load((folder / "point_correspondences.yaml").read_text())
    path = tmp_path_factory.mktemp("corners") / "corners.csv"
    lines = [f"cuboid.png,{k},{x},{y}" for k, (x, y) in enumerate(published["image_points"])]
    path.write_text("\n".join(["image,corner,x_px,y_px", *lines]))
    return read_corners(path)["cuboid.png"]


def test_the_scale_is_that_of_the_published_homography(folder: Path, outline: Outline) -> None:
    sensor = load_sensor("gelsight_mini")
    found = measure_pixel_scale([outline], SHAPE, sensor)
    px_per_mm = np.abs(np.load(folder / "homography.npy")[:2, :2]).max(axis=0)
    np.testing.assert_allclose(found.mm_per_px, 1 / px_per_mm, rtol=1e-6)
    assert found.residual_px < 1e-4
    assert found.disagreement(sensor) == ""  # 0.0714 as shipped


def test_a_cuboid_without_a_reference_is_not_guessed(folder: Path) -> None:
    """Against the mean light no edge is sharp: rather no scale than one that is off by percents."""
    image, look = read_image(folder / "cuboid_10-2-284.png"), MarkerAppearance(9.0)
    light = cv2.GaussianBlur(image, (0, 0), 60.0)
    changed, known = image_change(image, light, look, 0.5), ~marker_pixels(image, light, look)
    with pytest.raises(ConfigError, match=r"cuboid.png: no cuboid found; .* by hand"):
        find_outline(changed, SHAPE, (1 / 14, 1 / 14), known, "cuboid.png")

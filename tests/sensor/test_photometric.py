"""Slopes from images under one lamp each; the vendor's heights with `-m external`."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from tactorch.errors import ConfigError
from tactorch.sensor.depth import integrate_slopes
from tactorch.sensor.photometric import Photometric


def scene(paint: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Slopes of a bumpy face, and its images under five lamps; the paint varies."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:90, :110] / 10.0
    slopes = np.zeros((90, 110, 2))
    for _ in range(12):
        px, py, height, width = rng.uniform((0, 0, -0.5, 0.7), (11, 9, 0.5, 2.0))
        bump = height * np.exp(-((x - px) ** 2 + (y - py) ** 2) / (2 * width**2))
        slopes += -(bump / width**2)[..., None] * np.stack([x - px, y - py], axis=-1)
    normal = np.concatenate([-slopes, np.ones((90, 110, 1))], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    turns = np.arange(5) * 2 * np.pi / 5
    lamps = np.stack([0.7 * np.cos(turns), 0.7 * np.sin(turns), np.full(5, 0.7)])
    albedo = 1 + paint * cv2.GaussianBlur(rng.normal(size=(90, 110)), (0, 0), 2.0)
    images = 200 * albedo[..., None] * np.maximum(normal @ lamps, 0.05)
    return slopes, images + rng.normal(0, 0.5, images.shape)


def test_slopes_of_another_face_are_seen_whatever_the_paint() -> None:
    slopes, images = scene(0.0, 0)
    found = Photometric.fit(images, slopes, np.ones((90, 110), dtype=bool), 0.7)
    new, painted = scene(1.0, 1)
    off = found.slopes(painted) - new
    assert 1 - off.var() / new.var() > 0.97


def test_wrong_images_are_refused() -> None:
    slopes, images = scene(0.0, 0)
    everywhere = np.ones((90, 110), dtype=bool)
    with pytest.raises(ConfigError, match="2 images: slopes take three"):
        Photometric.fit(images[..., :2], slopes, everywhere)
    few = np.zeros_like(everywhere)
    few[0, :9] = True
    with pytest.raises(ConfigError, match="9 known pixels are too few"):
        Photometric.fit(images, slopes, few)
    found = Photometric.fit(images, slopes, everywhere)
    with pytest.raises(ConfigError, match="4 images; the map is of 5 lamps"):
        found.slopes(images[..., :4])


def heights(path: Path) -> tuple[np.ndarray, float]:
    """Read a TrueMap file: heights in mm and the size of a pixel."""
    content = path.read_bytes()
    at = content.index(b"\0", 32) + 1
    columns, rows = np.frombuffer(content, np.uint32, 2, at)
    width = np.frombuffer(content, np.float32, 1, at + 8)[0]
    values = np.frombuffer(content, np.float32, int(rows) * int(columns), at + 24)
    return values.reshape(rows, columns).astype(float), float(width) / int(columns)


@pytest.mark.external
def test_a_groove_against_the_vendors_heights(shared_data: Path) -> None:
    """Fitted on every other row; heights within 0.01 mm on the rows held out."""
    folder = shared_data / "gelsight-groove"
    truth, size = heights(folder / "heightmap.tmd")
    images = np.stack(
        [cv2.imread(str(folder / f"image0{k}.png"), 0).astype(float) for k in range(1, 7)], axis=-1
    )
    slopes = np.stack(np.gradient(truth, size)[::-1], axis=-1)
    held_out = np.zeros(truth.shape, dtype=bool)
    held_out[1::2] = True
    seen = Photometric.fit(images, slopes, ~held_out).slopes(images)
    off = integrate_slopes(seen[..., 0], seen[..., 1], (size, size)) - truth
    assert off[held_out].std() < 0.007
    off_x = (seen - slopes)[held_out][:, 0]
    assert 1 - off_x.var() / slopes[held_out][:, 0].var() > 0.98

"""Images of dark dots on coloured light, drawn without any of the package's code."""

import numpy as np


def draw(
    places: np.ndarray,
    *,
    shape: tuple[int, int] = (240, 320),
    radius: float = 5.0,
    noise: float = 2.0,
    seed: int = 0,
    flash: tuple[float, float] | None = None,
    radii: np.ndarray | None = None,
) -> np.ndarray:
    """Draw dots with soft edges; `flash` adds a strong red light about a place."""
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    light = np.stack([150 + 0.2 * x, 130 + 0.2 * y, 170 - 0.1 * x], axis=2)
    if flash is not None:
        glow = np.exp(-((x - flash[0]) ** 2 + (y - flash[1]) ** 2) / (2 * 30.0**2))
        light += glow[..., None] * (120, 10, -60)
    bright = np.ones(shape)
    for i, (px, py) in enumerate(places):
        size = radius if radii is None else radii[i]
        bright *= 1 - 0.8 / (1 + np.exp((np.hypot(x - px, y - py) - size) / 0.4))
    image = light * bright[..., None]
    image += np.random.default_rng(seed).normal(0, noise, image.shape)
    return np.clip(image, 0, 255).astype(np.uint8)


def grid(rows: int = 7, columns: int = 9, pitch: float = 32.0) -> np.ndarray:
    """Places of a grid of dots, slightly irregular."""
    y, x = np.mgrid[:rows, :columns] * pitch + 24.0
    places = np.stack([x, y], axis=-1).reshape(-1, 2)
    return places + np.random.default_rng(9).uniform(-2, 2, places.shape)


def pressed(places: np.ndarray, amount: float) -> np.ndarray:
    """Move dots outward about a place and to the side, by `amount` px at most or so."""
    offset = places - (150.0, 110.0)
    away = offset / 60.0 * np.exp(-0.5 * (np.linalg.norm(offset, axis=1) / 60.0) ** 2)[:, None]
    return places + amount * (1.6 * away + (0.3, -0.2))

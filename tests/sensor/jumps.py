"""Stills of a grid of dots that moves far between images, drawn with known places."""

import numpy as np

from .dots import draw

SHAPE = (480, 640)
PITCH = 40.0


def lattice(jitter: float, seed: int, rows: int = 9, columns: int = 13) -> np.ndarray:
    """Places of a grid with room around it, off by up to `jitter` px each."""
    y, x = np.mgrid[:rows, :columns] * PITCH
    places = np.stack([x, y], axis=-1).reshape(-1, 2)
    places += np.array(SHAPE[::-1]) / 2 - places.mean(axis=0)
    return places + np.random.default_rng(seed).uniform(-jitter, jitter, places.shape)


def dragged(
    places: np.ndarray, pitches: float, angle: float = 0.3, width: float = 3.0
) -> np.ndarray:
    """Move those about a place along a direction, by so many pitches in the middle."""
    near = np.exp(-0.5 * (np.linalg.norm(places - (330.0, 230.0), axis=1) / (width * PITCH)) ** 2)
    return places + pitches * PITCH * near[:, None] * (np.cos(angle), np.sin(angle))


def twisted(places: np.ndarray, degrees: float) -> np.ndarray:
    """Turn those about a place, ever less away from it."""
    offset = places - (320.0, 240.0)
    turn = np.deg2rad(degrees) * np.exp(
        -0.5 * (np.linalg.norm(offset, axis=1) / (2.5 * PITCH)) ** 2
    )
    c, s = np.cos(turn), np.sin(turn)
    x, y = offset.T
    return places + np.stack([c * x - s * y, s * x + c * y], axis=1) - offset


def moved(places: np.ndarray) -> dict[str, np.ndarray]:
    """Places after motions of a pitch and more, by name."""
    return {
        "dragged by half a pitch": dragged(places, 0.5),
        "dragged by a pitch": dragged(places, 1.0),
        "dragged by 1.5 pitches": dragged(places, 1.5),
        "dragged by a pitch along a row": dragged(places, 1.0, 0.0),
        "twisted by 25 degrees": twisted(places, 25.0),
        "twisted by 40 degrees": twisted(places, -40.0),
        "shifted by a pitch": places + np.array([PITCH, 0.0]),
        "shifted askew by a pitch": places + np.array([PITCH, -PITCH]),
        "shifted by 0.7 pitches, dragged": dragged(places + np.array([0.7 * PITCH, 0.0]), 0.8, 2.0),
    }


def image(places: np.ndarray, seed: int) -> np.ndarray:
    """Draw the dots, some sizes off, with noise and strong light somewhere."""
    return draw(places, shape=SHAPE, radius=6.0, noise=3.0, seed=seed, flash=(300, 200))

"""Images of a ball pressed into a gel under coloured lights, drawn without the package's code."""

import numpy as np

SHAPE = (96, 110)
MM_PER_PX = 0.05
RADIUS_MM = 1.5
LIGHTS = np.array([(0.8, 0.0, 0.6), (-0.4, 0.7, 0.6), (-0.4, -0.7, 0.6)])


def slopes(center: tuple[float, float], contact_px: float) -> np.ndarray:
    """dz/dx and dz/dy of the gel: the ball's inside its contact, dying away outside."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    dx, dy = (x - center[0]) * MM_PER_PX, (y - center[1]) * MM_PER_PX
    r, edge = np.hypot(dx, dy), contact_px * MM_PER_PX
    inner = r / np.sqrt(np.maximum(RADIUS_MM**2 - r**2, 1e-6))
    rim = edge / np.sqrt(RADIUS_MM**2 - edge**2)
    steep = np.where(r <= edge, inner, rim * np.exp(-(r - edge) / 0.15))
    return np.stack([dx, dy], axis=-1) * (steep / np.maximum(r, 1e-9))[..., None]


def shaded(slope: np.ndarray, noise: float = 1.5, seed: int = 0) -> np.ndarray:
    """The image of a face of given slopes: matt, three lights, falling off to the right."""
    normal = np.concatenate([-slope, np.ones((*slope.shape[:2], 1))], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    light = 60 + 180 * np.maximum(normal @ LIGHTS.T, 0.0)
    light *= np.linspace(1.0, 0.75, slope.shape[1])[None, :, None]
    light += np.random.default_rng(seed).normal(0, noise, light.shape)
    return np.clip(light, 0, 255).astype(np.uint8)


def ball(center: tuple[float, float], contact_px: float = 18.0, seed: int = 1) -> np.ndarray:
    """A press of the ball."""
    return shaded(slopes(center, contact_px), seed=seed)


def still(seed: int = 99) -> np.ndarray:
    """The gel without contact."""
    return shaded(np.zeros((*SHAPE, 2)), seed=seed)

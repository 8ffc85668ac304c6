"""A renderer in NumPy and OpenCV, image by image, which the differentiable camera agrees with."""

import cv2
import numpy as np

from tactorch.sensor.render import Lamps


def illuminated(lamps: Lamps, height: np.ndarray, size: tuple[float, float]) -> np.ndarray:
    """Light from a face, (h, w, 3)."""
    slope_y, slope_x = np.gradient(height, size[1], size[0])
    normal = np.stack([slope_x, slope_y, -np.ones_like(slope_x)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    light = np.broadcast_to(lamps.ambient, (*height.shape, 3)).copy()
    elevation = np.deg2rad(lamps.elevation_deg)
    rows, columns = (np.linspace(-1, 1, n) for n in height.shape)
    for azimuth, colour in zip(np.deg2rad(lamps.azimuths_deg), lamps.colours, strict=True):
        toward = np.array([np.cos(azimuth), np.sin(azimuth)])
        direction = np.array([*np.cos(elevation) * toward, -np.sin(elevation)])
        proximity = columns * toward[0] + rows[:, None] * toward[1]
        intensity = np.maximum(normal @ direction, 0.0)
        intensity *= 1.0 - lamps.falloff * (1.0 - proximity) / 2.0
        intensity *= 1.0 - lamps.shadow * shadow(height, direction, size)
        light += intensity[..., None] * np.array(colour)
    return light


def shadow(height: np.ndarray, direction: np.ndarray, size: tuple[float, float]) -> np.ndarray:
    """Fraction of each pixel in the shadow of the face."""
    relief = -height.astype(np.float32)
    in_plane = float(np.hypot(direction[0], direction[1]))
    rise = -direction[2] / in_plane
    step, dark = 2.0 * max(size), np.zeros(relief.shape, np.float32)
    rows, columns = np.indices(relief.shape, dtype=np.float32)
    for k in range(1, min(60, int(float(np.ptp(relief)) / rise / step)) + 1):
        x = (columns + k * step * direction[0] / in_plane / size[0]).astype(np.float32)
        y = (rows + k * step * direction[1] / in_plane / size[1]).astype(np.float32)
        occluder = cv2.remap(relief, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        excess = occluder - relief - rise * k * step
        dark = np.maximum(dark, np.clip(excess / 0.05, 0.0, 1.0))
    return dark.astype(np.float64)


def covered(centers: np.ndarray, radius: tuple[float, float], shape: tuple[int, int]) -> np.ndarray:
    """Fraction of each pixel that a marker covers."""
    y, x = np.indices(shape)
    coverage = np.zeros(shape)
    for center in centers:
        distance = np.hypot((x - center[0]) / radius[0], (y - center[1]) / radius[1])
        exponent = np.clip((distance - 1) * np.mean(radius) / 0.5 * 2, -40, 40)
        coverage = np.maximum(coverage, 1.0 / (1.0 + np.exp(exponent)))
    return coverage

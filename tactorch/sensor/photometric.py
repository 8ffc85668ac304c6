"""Slopes from images under one lamp each, with unknown lamp directions (after Woodham, 1980).

The brightness of a pixel under one lamp relative to all lamps depends on the slope, not on the
paint. A polynomial of second degree maps these ratios to slopes; its coefficients vary over the
image to second degree because the lamps are near. It is fitted where slopes are known.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float

from tactorch.errors import ConfigError

_RIDGE = 1e-6


@dataclass(frozen=True, eq=False)
class Photometric:
    """Map from the brightness under each lamp to slopes.

    Attributes:
        weights: Coefficients of each term, for dz/dx and dz/dy.
        lamps: Number of lamps.
        smooth_px: Standard deviation of the smoothing of images.
    """

    weights: Float[np.ndarray, "terms 2"]
    lamps: int
    smooth_px: float

    @classmethod
    def fit(
        cls,
        images: Float[np.ndarray, "h w lamps"],
        slopes: Float[np.ndarray, "h w 2"],
        known: Bool[np.ndarray, "h w"],
        smooth_px: float = 1.0,
    ) -> "Photometric":
        """Return the map fitted to images under each lamp where the slopes are known."""
        if images.shape[2] < 3:
            raise ConfigError(f"{images.shape[2]} images: slopes take three lamps or more.")
        terms = _terms(images, smooth_px)[known]
        if len(terms) < 2 * terms.shape[1]:
            raise ConfigError(
                f"{len(terms)} known pixels are too few for {terms.shape[1]} coefficients."
            )
        normal = terms.T @ terms + _RIDGE * len(terms) * np.eye(terms.shape[1])
        return cls(np.linalg.solve(normal, terms.T @ slopes[known]), images.shape[2], smooth_px)

    def slopes(self, images: Float[np.ndarray, "h w lamps"]) -> Float[np.ndarray, "h w 2"]:
        """Return dz/dx and dz/dy."""
        if images.shape[2] != self.lamps:
            raise ConfigError(f"{images.shape[2]} images; the map is of {self.lamps} lamps.")
        return _terms(images, self.smooth_px) @ self.weights


def _terms(images: Float[np.ndarray, "h w lamps"], smooth_px: float) -> np.ndarray:
    if smooth_px > 0:
        images = cv2.GaussianBlur(images, (0, 0), smooth_px)
    ratio = images / np.maximum(images.mean(axis=-1, keepdims=True), 1e-9)
    rows, columns = ratio.shape[:2]
    y, x = (v[..., None] for v in np.mgrid[-1 : 1 : rows * 1j, -1 : 1 : columns * 1j])
    linear = np.concatenate([np.ones((rows, columns, 1)), ratio], axis=-1)
    a, b = np.triu_indices(ratio.shape[2])
    positional = [linear * position for position in (x, y, x * y, x * x, y * y)]
    return np.concatenate([linear, ratio[..., a] * ratio[..., b], *positional], axis=-1)

"""Slopes from images under one lamp each, the lamps not known (Woodham, 1980, by regression).

How bright a pixel is under one lamp, against all lamps, tells the slope and not the paint. The map
from these shares to slopes is a polynomial of second degree whose coefficients vary over the image
to second degree, for lamps are near; it is fitted where slopes are known.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from tactorch.errors import ConfigError

_RIDGE = 1e-6


@dataclass(frozen=True, eq=False)
class Photometric:
    """A map from the brightness under each lamp to slopes.

    Attributes:
        weights: Of each term, for dz/dx and dz/dy.
        lamps: Their number.
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
        """Fit the map where slopes are known.

        Args:
            images: Brightness under each lamp.
            slopes: dz/dx and dz/dy.
            known: Where they are known.
            smooth_px: Standard deviation of the smoothing of images.

        Raises:
            ConfigError: There are fewer than three lamps, or too few known pixels.
        """
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
        """Return dz/dx and dz/dy.

        Raises:
            ConfigError: There are more or fewer lamps than the map was fitted to.
        """
        if images.shape[2] != self.lamps:
            raise ConfigError(f"{images.shape[2]} images; the map is of {self.lamps} lamps.")
        return _terms(images, self.smooth_px) @ self.weights


def _terms(images: Float[np.ndarray, "h w lamps"], smooth_px: float) -> np.ndarray:
    import cv2

    smooth = images
    if smooth_px > 0:
        smooth = np.stack(
            [cv2.GaussianBlur(one, (0, 0), smooth_px) for one in np.moveaxis(images, 2, 0)], axis=-1
        )
    share = smooth / np.maximum(smooth.mean(axis=-1, keepdims=True), 1e-9)
    rows, columns = share.shape[:2]
    y, x = (v[..., None] for v in np.mgrid[-1 : 1 : rows * 1j, -1 : 1 : columns * 1j])
    linear = np.concatenate([np.ones((rows, columns, 1)), share], axis=-1)
    a, b = np.triu_indices(share.shape[2])
    places = [linear * place for place in (x, y, x * y, x * x, y * y)]
    return np.concatenate([linear, share[..., a] * share[..., b], *places], axis=-1)

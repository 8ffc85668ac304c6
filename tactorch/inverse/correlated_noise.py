"""Errors that data have in common: a few patterns of unknown size on top of white noise."""

import numpy as np
from jaxtyping import Float


class CorrelatedNoise:
    """Whitens residuals whose covariance is the unit matrix plus B B^T.

    B has few columns, each the pattern of an error of unit standard deviation, in standard
    deviations of the white noise. With B = U S V^T the symmetric root of the inverse is
    1 - U (1 - (1 + S^2)^(-1/2)) U^T.
    """

    def __init__(self, patterns: Float[np.ndarray, "data k"]) -> None:
        """Decompose the patterns."""
        self._basis, self._sizes, _ = np.linalg.svd(patterns, full_matrices=False)
        self._loss = 1.0 - 1.0 / np.sqrt(1.0 + self._sizes**2)

    def widened(self, factors: Float[np.ndarray, " data"]) -> "CorrelatedNoise":
        """Return the same error in deviations of a white noise that is `factors` times as large."""
        return CorrelatedNoise(self._basis * self._sizes / factors[:, None])

    def whiten(self, values: Float[np.ndarray, "data *k"]) -> Float[np.ndarray, "data *k"]:
        """Return the whitened residuals or their derivatives; the map is its own transpose."""
        if values.ndim == 1:  # not by BLAS: see `tactorch.linalg.vectors`
            inner = self._loss * np.einsum("dk,d->k", self._basis, values)
            return values - np.einsum("dk,k->d", self._basis, inner)
        return values - self._basis @ (self._loss[:, None] * (self._basis.T @ values))

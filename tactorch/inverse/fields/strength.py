"""Parameters of inclusions on which the data depend nearly linearly.

From afar, a ball of radius R and contrast c acts by its strength R^3 (c - 1) / (c + 3/2) (J. D.
Eshelby, "The determination of the elastic field of an ellipsoidal inclusion, and related problems",
Proc. R. Soc. A 241 (1957), 376-396, for nearly incompressible bodies), and the next term of its
field is larger by R^2. The data depend on the strength and on R^2 nearly linearly, but not on the
logarithms of radius and contrast: their posterior is skewed, and the objective has a curved valley.
"""

import numpy as np
from jaxtyping import Float

_POISSON_TERM = 1.5  # of the strength, for nearly incompressible bodies
_MAX_LOG_CHANGE = 0.7  # of radius or contrast in one step: a factor of two


def from_logs(logs: Float[np.ndarray, "*k 2"]) -> Float[np.ndarray, "*k 2"]:
    """Return squared radius (mm^2) and strength (mm^3) from log-radius and log-contrast."""
    radius, contrast = np.moveaxis(np.exp(logs), -1, 0)
    strength = radius**3 * (contrast - 1.0) / (contrast + _POISSON_TERM)
    return np.stack([radius**2, strength], axis=-1)


def to_logs(linear: Float[np.ndarray, "*k 2"]) -> Float[np.ndarray, "*k 2"]:
    """Return log-radius and log-contrast, the inverse of `from_logs`; NaN where there are none."""
    square, strength = np.moveaxis(linear, -1, 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = strength / square**1.5
        log_contrast = np.log((1.0 + _POISSON_TERM * ratio) / (1.0 - ratio))
        return np.stack([0.5 * np.log(square), log_contrast], axis=-1)


def derivative(logs: Float[np.ndarray, "*k 2"]) -> Float[np.ndarray, "*k 2 2"]:
    """Return the derivative of `from_logs`."""
    radius, contrast = np.moveaxis(np.exp(logs), -1, 0)
    square, strength = np.moveaxis(from_logs(logs), -1, 0)
    by_contrast = radius**3 * (1.0 + _POISSON_TERM) * contrast / (contrast + _POISSON_TERM) ** 2
    rows = [[2.0 * square, np.zeros_like(square)], [3.0 * strength, by_contrast]]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def moved(logs: Float[np.ndarray, "2"], step: Float[np.ndarray, "2"]) -> Float[np.ndarray, "2"]:
    """Return the logarithms after a step that is straight in squared radius and strength.

    To first order this is `logs + step`. A step that is too large or leads to no contrast is
    shortened.
    """
    linear, change = from_logs(logs), derivative(logs) @ step
    for factor in 0.5 ** np.arange(10):
        new = to_logs(linear + factor * change)
        if np.isfinite(new).all() and np.abs(new - logs).max() < _MAX_LOG_CHANGE:
            return new
    return logs + factor * step

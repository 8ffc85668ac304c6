"""Levels of log-modulus that a prior refers to: given, or estimated from the field itself.

An estimated level is always the one that makes its penalty smallest. The penalty of the field is
then a minimum over levels, so its gradient is the one at the level held still (envelope theorem),
and what majorises the penalty at that level majorises it with the level free.
"""

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.mesh import TetMesh

_SWEEPS, _SETTLED = 200, 1e-12


def relative_volumes(mesh: TetMesh) -> Float[np.ndarray, " m"]:
    """Volumes of the elements over their mean."""
    return mesh.volumes / mesh.volumes.mean()


def log_level(
    level_mpa: float | Float[np.ndarray, " m"] | None, size: int
) -> float | Float[np.ndarray, " m"] | None:
    """Return the logarithm of a level (MPa): one, or one an element; None stays None.

    Raises:
        ConfigError: it is not positive, or its shape is wrong.
    """
    if level_mpa is None:
        return None
    level = np.asarray(level_mpa, dtype=np.float64)
    if level.shape not in ((), (size,)):
        raise ConfigError(
            f"regularization.level_mpa has shape {level.shape}; give one modulus or ({size},)."
        )
    if not (np.all(level > 0) and np.all(np.isfinite(level))):
        raise ConfigError(f"regularization.level_mpa={level_mpa} must be above 0 MPa.")
    return float(np.log(level)) if level.ndim == 0 else np.log(level)


def weighted_median(field: Float[np.ndarray, " m"], weights: Float[np.ndarray, " m"]) -> float:
    """Value below which half of the weight lies."""
    order = np.argsort(field)
    below = np.cumsum(weights[order])
    return float(field[order][np.searchsorted(below, 0.5 * below[-1])])


def smoothed_median(
    field: Float[np.ndarray, " m"], weights: Float[np.ndarray, " m"], edge: float
) -> float:
    """Return the level c that minimises the sum of weights * sqrt((field - c)^2 + edge^2).

    The weighted median where `edge` is small beside the spread. The sum is strictly convex in c:
    bisection on its slope.
    """
    low, high = float(field.min()), float(field.max())
    level = weighted_median(field, weights)
    for _ in range(_SWEEPS):
        distance = field - level
        slope = float(weights @ (distance / np.sqrt(distance * distance + edge * edge)))
        low, high = (level, high) if slope > 0 else (low, level)
        if slope == 0 or high - low <= _SETTLED * max(1.0, abs(level)):
            break
        level = 0.5 * (low + high)
    return level


def two_levels(
    field: Float[np.ndarray, " m"], weights: Float[np.ndarray, " m"]
) -> tuple[float, float]:
    """Return the levels (low, high) that minimise the sum of weights * (f - low)^2 (f - high)^2.

    With p(f) = f^2 - s f + q = (f - low)(f - high) this is linear least squares in s and q, and p
    is the second orthogonal polynomial of the field's distribution: its roots are real and within
    the field's range. They are the nodes of the two-point Gauss rule: exact for a binary map.
    """
    mean = float(np.average(field, weights=weights))
    centred = field - mean
    variance = float(np.average(centred**2, weights=weights))
    if variance <= 1e-24 * max(1.0, mean * mean):
        return mean, mean
    skew = float(np.average(centred**3, weights=weights)) / variance
    half = float(np.sqrt(0.25 * skew * skew + variance))
    return mean + 0.5 * skew - half, mean + 0.5 * skew + half

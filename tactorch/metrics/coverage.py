"""Coverage and calibration of posterior intervals over objects of known truth."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import ndtri

from tactorch.errors import ConfigError

# Truth, mean and standard deviation of each element, in the posterior's parameter.
Estimate = tuple[np.ndarray, np.ndarray, np.ndarray]
_Levels = Float[np.ndarray, " k"]
_LEVELS = np.linspace(0.05, 0.95, 19)


class Coverage(NamedTuple):
    """Fraction of true values within intervals of one level.

    Attributes:
        level: Nominal probability of the intervals.
        fraction: Weighted fraction over all elements of all objects.
        per_object: Weighted fraction over each object's elements.
    """

    level: float
    fraction: float
    per_object: Float[np.ndarray, " objects"]


def normal_quantile(level: float) -> float:
    """Return half the width of the central normal interval of a level, in standard deviations."""
    if not 0 < level < 1:
        raise ConfigError(f"level={level} must lie between 0 and 1, such as 0.95.")
    return float(ndtri(0.5 + 0.5 * level))


def coverage(
    objects: Sequence[Estimate], level: float = 0.95, weights: Sequence[np.ndarray] | None = None
) -> Coverage:
    """Count true values within the central normal intervals.

    Args:
        objects: Truth, mean and standard deviation of each element, per object.
        level: Nominal probability of the intervals.
        weights: Weight of each element, per object, such as its volume; equal by default.
    """
    quantile = normal_quantile(level)
    if len(objects) == 0:
        raise ConfigError("objects is empty; give at least one (truth, mean, deviation).")
    hits = [_distance(i, *estimate) <= quantile for i, estimate in enumerate(objects)]
    if weights is None:
        weights = [np.ones(len(hit)) for hit in hits]
    _check_weights(weights, hits)
    pairs = list(zip(hits, weights, strict=True))
    per_object = np.array([float(np.average(hit, weights=weight)) for hit, weight in pairs])
    total = sum(float(weight.sum()) for weight in weights)
    return Coverage(level, sum(float(hit @ weight) for hit, weight in pairs) / total, per_object)


def calibration_curve(objects: Sequence[Estimate], levels: _Levels = _LEVELS) -> _Levels:
    """Return the covered fraction at each level; equal to the levels if deviations are exact."""
    return np.array([coverage(objects, float(level)).fraction for level in levels])


def calibration_error(objects: Sequence[Estimate], levels: _Levels = _LEVELS) -> float:
    """Return the mean distance of the covered fraction from the level; 0 is perfect."""
    return float(np.abs(calibration_curve(objects, levels) - levels).mean())


def _check_weights(weights: Sequence[np.ndarray], hits: Sequence[np.ndarray]) -> None:
    if len(weights) != len(hits):
        raise ConfigError(
            f"weights of {len(weights)} objects for {len(hits)}; give one array each."
        )
    for i, (weight, hit) in enumerate(zip(weights, hits, strict=True)):
        if weight.shape != hit.shape or not np.all(weight >= 0) or not weight.sum() > 0:
            raise ConfigError(
                f"object {i}: weights {weight.shape} must be {hit.shape}, none negative and not "
                "all 0."
            )


def _distance(index: int, truth: np.ndarray, mean: np.ndarray, deviation: np.ndarray) -> np.ndarray:
    """Distance of truth and mean in standard deviations."""
    if not truth.shape == mean.shape == deviation.shape or truth.size == 0:
        raise ConfigError(
            f"object {index}: truth {truth.shape}, mean {mean.shape} and deviation "
            f"{deviation.shape} must have one shape, with at least one element."
        )
    if not np.all(deviation > 0):
        raise ConfigError(f"object {index}: every deviation must be above 0.")
    return np.abs(truth - mean) / deviation

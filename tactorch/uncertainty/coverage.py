"""Do stated uncertainties hold? Judged over objects whose truth is known."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import ndtri

from tactorch.errors import ConfigError

# Truth, mean and standard deviation of each element, in the posterior's parameter.
Judged = tuple[np.ndarray, np.ndarray, np.ndarray]
_LEVELS = np.linspace(0.05, 0.95, 19)


@dataclass(frozen=True, eq=False)
class Coverage:
    """Share of true values within intervals of one level.

    Attributes:
        level: Probability that the intervals claim.
        fraction: Share over all elements of all objects, by weight where they have one.
        per_object: Share of each object's elements, likewise.
    """

    level: float
    fraction: float
    per_object: Float[np.ndarray, " objects"]


def coverage(
    objects: Sequence[Judged],
    level: float = 0.95,
    weights: Sequence[np.ndarray] | None = None,
) -> Coverage:
    """Count true values within the central normal intervals.

    Args:
        objects: Truth, mean and standard deviation of each element, per object.
        level: Probability that the intervals claim.
        weights: How much each element counts, per object: its volume, say; all alike by default.

    Raises:
        ConfigError: no object, shapes that differ, a deviation that is not positive, weights that
            are negative or fit no element, or a level not between 0 and 1.
    """
    if not 0 < level < 1:
        raise ConfigError(f"level={level} must lie between 0 and 1, such as 0.95.")
    if len(objects) == 0:
        raise ConfigError("objects is empty; give at least one (truth, mean, deviation).")
    reach = float(ndtri(0.5 + 0.5 * level))
    hits = [_distance(i, judged) <= reach for i, judged in enumerate(objects)]
    if weights is None:
        weights = [np.ones(len(hit)) for hit in hits]
    _check_weights(weights, hits)
    pairs = list(zip(hits, weights, strict=True))
    per_object = np.array([float(np.average(hit, weights=weight)) for hit, weight in pairs])
    total = sum(float(weight.sum()) for weight in weights)
    return Coverage(level, sum(float(hit @ weight) for hit, weight in pairs) / total, per_object)


def calibration_curve(
    objects: Sequence[Judged], levels: Float[np.ndarray, " k"] = _LEVELS
) -> Float[np.ndarray, " k"]:
    """Return the covered share at each level; equal to the levels where deviations are right."""
    return np.array([coverage(objects, float(level)).fraction for level in levels])


def calibration_error(
    objects: Sequence[Judged], levels: Float[np.ndarray, " k"] = _LEVELS
) -> float:
    """Return the mean distance of the covered share from the level: 0 is perfect."""
    return float(np.abs(calibration_curve(objects, levels) - levels).mean())


def _check_weights(weights: Sequence[np.ndarray], hits: Sequence[np.ndarray]) -> None:
    if len(weights) != len(hits):
        raise ConfigError(
            f"weights of {len(weights)} objects for {len(hits)}; give one array each."
        )
    for i, (weight, hit) in enumerate(zip(weights, hits, strict=True)):
        if weight.shape != hit.shape or not np.all(weight >= 0) or not weight.sum() > 0:
            raise ConfigError(
                f"object {i}: weights {weight.shape} must be one an element ({hit.shape}), none "
                "negative and not all 0."
            )


def _distance(index: int, judged: Judged) -> np.ndarray:
    """Return the distance of truth and mean in standard deviations."""
    truth, mean, deviation = judged
    if not truth.shape == mean.shape == deviation.shape or truth.size == 0:
        raise ConfigError(
            f"object {index}: truth {truth.shape}, mean {mean.shape} and deviation "
            f"{deviation.shape} must have one shape, with at least one element."
        )
    if not np.all(deviation > 0):
        raise ConfigError(f"object {index}: every deviation must be above 0.")
    return np.abs(truth - mean) / deviation

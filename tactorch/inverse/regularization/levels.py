"""Penalties on the difference from levels of log-modulus, given or estimated from the field.

An estimated level minimises its penalty. The gradient of the penalty is then the one at a fixed
level (envelope theorem), and a majorant at that level is a majorant with the level free.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float

from tactorch.config import option
from tactorch.errors import ConfigError
from tactorch.inverse.regularization.base import (
    Prior,
    Quadratic,
    Regularizer,
    log_level,
    relative_volumes,
)
from tactorch.mesh import TetMesh

_MAX_BISECTIONS, _LEVEL_TOLERANCE = 200, 1e-12


@dataclass(frozen=True, kw_only=True)
class Tikhonov(Prior):
    """Tikhonov: squared difference from a reference modulus.

    Half the sum over elements of volume * (log E - log reference)^2, in mean volumes.

    Attributes:
        level_mpa: Reference, MPa; None takes the volume-weighted mean of the log-moduli.
    """

    level_mpa: float | None = option(
        None, "Reference modulus; null: the mean of the present map", unit="MPa", gt=0
    )

    def on(self, mesh: TetMesh) -> Quadratic:
        """Return the penalty on a mesh."""
        volumes = relative_volumes(mesh)
        return Quadratic(sp.diags(volumes), log_level(self.level_mpa), volumes)


@dataclass(frozen=True, kw_only=True)
class Sparsity(Prior):
    """Sparsity: few elements differ from a background modulus, possibly by much.

    Sum over elements of volume * (sqrt((log E - background)^2 + edge^2) - edge), in mean volumes,
    minimised by reweighted least squares.

    Attributes:
        edge: Difference of log-modulus below which the penalty is quadratic.
        level_mpa: Background, MPa; None takes the volume-weighted median of the log-moduli,
            smoothed like the penalty.
    """

    edge: float = option(
        0.03, "Difference of log-modulus below which the penalty is quadratic", gt=0
    )
    level_mpa: float | None = option(
        None, "Background modulus; null: the median of the present map", unit="MPa", gt=0
    )

    def on(self, mesh: TetMesh) -> "SparsityPenalty":
        """Return the penalty on a mesh."""
        return SparsityPenalty(relative_volumes(mesh), log_level(self.level_mpa), self.edge)


class SparsityPenalty(Regularizer):
    """The penalty of `Sparsity` on a mesh."""

    def __init__(self, volumes: Float[np.ndarray, " m"], level: float | None, edge: float) -> None:
        """Store volumes over their mean, log-background and edge."""
        self._volumes, self._level, self._edge = volumes, level, edge

    def _differences(self, field: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Differences from the background, and their smoothed sizes."""
        level = self._level
        if level is None:
            level = smoothed_median(field, self._volumes, self._edge)
        difference = field - level
        return difference, np.sqrt(difference * difference + self._edge**2)

    def value(self, field: Float[np.ndarray, " m"]) -> float:
        """Return the penalty, zero at the background."""
        return float(self._volumes @ (self._differences(field)[1] - self._edge))

    def gradient(self, field: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Return the gradient of the penalty."""
        difference, size = self._differences(field)
        return self._volumes * difference / size

    def curvature(self, field: Float[np.ndarray, " m"]) -> sp.csr_matrix:
        """Return the Hessian of the majorant at `field`."""
        return sp.diags(self._volumes / self._differences(field)[1]).tocsr()


@dataclass(frozen=True, kw_only=True)
class BinaryWell(Prior):
    """The paper's binary well: two levels, tissue and inclusion.

    Sum over elements of volume * (f - f_c)^2 (f - f_t)^2, in mean volumes, with f = log E. The
    paper (Section VII) states it for moduli; for log-moduli both wells are equally wide at any
    contrast. It is not convex.

    Attributes:
        levels_mpa: The two moduli e_t and e_c, MPa; None takes those that minimise the sum for
            the present field.
    """

    levels_mpa: tuple[float, float] | None = option(
        None, "Moduli of tissue and inclusion; null: estimated from the present map", unit="MPa",
        gt=0,
    )  # fmt: skip

    def __post_init__(self) -> None:
        """Check the levels.

        Raises:
            ConfigError: the levels are equal.
        """
        super().__post_init__()
        if self.levels_mpa is not None and self.levels_mpa[0] == self.levels_mpa[1]:
            raise ConfigError(
                f"regularization.levels_mpa={list(self.levels_mpa)}: give two different moduli "
                "above 0 MPa, or null."
            )

    def on(self, mesh: TetMesh) -> "BinaryWellPenalty":
        """Return the penalty on a mesh."""
        return BinaryWellPenalty(relative_volumes(mesh), self.levels_mpa)


class BinaryWellPenalty(Regularizer):
    """The penalty of `BinaryWell` on a mesh."""

    def __init__(
        self, volumes: Float[np.ndarray, " m"], levels_mpa: tuple[float, float] | None
    ) -> None:
        """Store volumes over their mean, and the levels."""
        self._volumes = volumes
        self._levels = levels_mpa and (float(np.log(levels_mpa[0])), float(np.log(levels_mpa[1])))

    def levels(self, field: Float[np.ndarray, " m"]) -> tuple[float, float]:
        """Return the log-moduli of the wells: given, or estimated from this field."""
        return self._levels or two_levels(field, self._volumes)

    def _product(self, field: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the product (f - f_c)(f - f_t), and its derivative."""
        low, high = self.levels(field)
        return (field - low) * (field - high), 2.0 * field - low - high

    def value(self, field: Float[np.ndarray, " m"]) -> float:
        """Return the penalty, zero for a map of the two levels."""
        product, _ = self._product(field)
        return float(self._volumes @ (product * product))

    def gradient(self, field: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Return the gradient of the penalty."""
        product, slope = self._product(field)
        return self._volumes * 2.0 * product * slope

    def curvature(self, field: Float[np.ndarray, " m"]) -> sp.csr_matrix:
        """Return the Hessian without its negative part between the wells; no majorant."""
        product, slope = self._product(field)
        convex = 2.0 * slope * slope + 4.0 * np.maximum(product, 0.0)
        return sp.diags(self._volumes * convex).tocsr()


def weighted_median(field: Float[np.ndarray, " m"], weights: Float[np.ndarray, " m"]) -> float:
    """Return the value below which half of the weight is."""
    order = np.argsort(field)
    below = np.cumsum(weights[order])
    return float(field[order][np.searchsorted(below, 0.5 * below[-1])])


def smoothed_median(
    field: Float[np.ndarray, " m"], weights: Float[np.ndarray, " m"], edge: float
) -> float:
    """Return the level c that minimises the sum of weights * sqrt((field - c)^2 + edge^2).

    It is the weighted median where `edge` is small relative to the spread. The sum is strictly
    convex in c, so bisection on its slope converges.
    """
    low, high = float(field.min()), float(field.max())
    level = weighted_median(field, weights)
    for _ in range(_MAX_BISECTIONS):
        difference = field - level
        slope = float(weights @ (difference / np.hypot(difference, edge)))
        low, high = (level, high) if slope > 0 else (low, level)
        if slope == 0 or high - low <= _LEVEL_TOLERANCE * max(1.0, abs(level)):
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

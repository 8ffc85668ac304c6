"""Penalties that keep sharp contrasts.

The cost of most grows more slowly than the square of a difference: of the log-moduli across an
interior face (total variation, logarithm of jumps), or of a log-modulus from a background
(sparsity). They are minimised by reweighted least squares. The binary well has two levels.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float
from scipy.optimize import brentq

from tactorch.config import option
from tactorch.errors import ConfigError
from tactorch.inverse.fields.regularization.base import (
    Field,
    LevelPrior,
    Prior,
    Regularizer,
    jumps,
    relative,
)
from tactorch.mesh import TetMesh

_LEVEL_TOLERANCE = 1e-12  # log-modulus
_Function = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class _ReweightedPenalty(Regularizer):
    """Sum of weight * cost(difference), with difference = matrix (field - level).

    The curvature at a field belongs to the quadratic majorant that touches the penalty there. It
    exists where the cost is concave in the squared difference. A level that depends on the field
    minimises the penalty, so that it adds nothing to the gradient (envelope theorem).
    """

    matrix: sp.csr_matrix
    weights: Float[np.ndarray, " n"]
    cost: _Function
    stiffness: _Function  # derivative of the cost by the difference, over the difference
    level: Callable[[np.ndarray], float | np.ndarray] = lambda _: 0.0
    variation_edge: float | None = None

    def _difference(self, field: np.ndarray) -> np.ndarray:
        return self.matrix @ (field - self.level(field))

    def value(self, field: Field) -> float:
        return float(self.weights @ self.cost(self._difference(field)))

    def gradient(self, field: Field) -> Field:
        difference = self._difference(field)
        return self.matrix.T @ (self.weights * self.stiffness(difference) * difference)

    def curvature(self, field: Field) -> sp.csr_matrix:
        weights = sp.diags(self.weights * self.stiffness(self._difference(field)))
        return (self.matrix.T @ weights @ self.matrix).tocsr()


def _smoothed_size(edge: float) -> tuple[_Function, _Function]:
    """Cost sqrt(difference^2 + edge^2) - edge, and its stiffness."""

    def size(difference: np.ndarray) -> np.ndarray:
        return np.sqrt(difference * difference + edge**2)

    return lambda difference: size(difference) - edge, lambda difference: 1.0 / size(difference)


@dataclass(frozen=True, kw_only=True)
class TotalVariation(Prior):
    """Total variation: sharp edges.

    Sum over interior faces of area * (sqrt(jump^2 + edge^2) - edge), in mean areas. Reweighted
    least squares is lagged diffusivity (Vogel and Oman, 1996).
    """

    edge: float = option(0.03, "Jump of log-modulus below which the penalty is quadratic", gt=0)

    def on(self, mesh: TetMesh) -> Regularizer:
        areas = relative(mesh.adjacency.areas)
        cost = _smoothed_size(self.edge)
        return _ReweightedPenalty(jumps(mesh), areas, *cost, variation_edge=self.edge)


@dataclass(frozen=True, kw_only=True)
class LogJumps(Prior):
    """Logarithm of jumps: keeps contrast better than total variation, but is not convex.

    Sum over interior faces of area * edge * log(1 + (jump / edge)^2), in mean areas: the
    Lorentzian of Black and Rangarajan (1996). Its force on a jump falls as the jump grows.
    """

    edge: float = option(0.1, "Jump of log-modulus at which the force is largest", gt=0)

    def on(self, mesh: TetMesh) -> Regularizer:
        edge = self.edge
        return _ReweightedPenalty(
            jumps(mesh),
            relative(mesh.adjacency.areas),
            lambda jump: edge * np.log1p((jump / edge) ** 2),
            lambda jump: 2.0 * edge / (edge**2 + jump * jump),
        )


@dataclass(frozen=True, kw_only=True)
class Sparsity(LevelPrior):
    """Sparsity: few elements differ from a background modulus, possibly by much.

    Sum over elements of volume * (sqrt((log E - background)^2 + edge^2) - edge), in mean volumes.
    The median of the present map is that of the log-moduli by volume, smoothed like the penalty,
    which it minimises.
    """

    edge: float = option(
        0.03, "Difference of log-modulus below which the penalty is quadratic", gt=0
    )

    def on(self, mesh: TetMesh) -> Regularizer:
        volumes, known = relative(mesh.volumes), self.level(mesh)

        def level(field: np.ndarray) -> float | np.ndarray:
            return smoothed_median(field, volumes, self.edge) if known is None else known

        matrix = sp.identity(mesh.n_tets, format="csr")
        return _ReweightedPenalty(matrix, volumes, *_smoothed_size(self.edge), level)


@dataclass(frozen=True, kw_only=True)
class BinaryWell(Prior):
    """The paper's binary well: two levels, tissue and inclusion.

    Sum over elements of volume * (f - f_c)^2 (f - f_t)^2, in mean volumes, with f = log E. The
    paper (Section VII) states it for moduli; for log-moduli both wells are equally wide at any
    contrast. It is not convex. Levels that are estimated minimise the sum for the present field.
    """

    levels_mpa: tuple[float, float] | None = option(
        None, "Moduli of tissue and inclusion; null: estimated from the present map", unit="MPa",
        gt=0,
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.levels_mpa is not None and self.levels_mpa[0] == self.levels_mpa[1]:
            raise ConfigError(
                f"regularization.levels_mpa={list(self.levels_mpa)}: give two different moduli "
                "above 0 MPa, or null."
            )

    def on(self, mesh: TetMesh) -> Regularizer:
        levels = self.levels_mpa and tuple(np.log(self.levels_mpa).tolist())
        return _BinaryWellPenalty(relative(mesh.volumes), levels)


@dataclass(frozen=True, eq=False)
class _BinaryWellPenalty(Regularizer):
    volumes: Field
    levels: tuple[float, ...] | None

    def _product(self, field: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the product (f - f_c)(f - f_t), and its derivative."""
        low, high = self.levels or two_levels(field, self.volumes)
        return (field - low) * (field - high), 2.0 * field - low - high

    def value(self, field: Field) -> float:
        product, _ = self._product(field)
        return float(self.volumes @ (product * product))

    def gradient(self, field: Field) -> Field:
        product, slope = self._product(field)
        return self.volumes * 2.0 * product * slope

    def curvature(self, field: Field) -> sp.csr_matrix:
        # The Hessian without its negative part between the wells; no majorant.
        product, slope = self._product(field)
        convex = 2.0 * slope * slope + 4.0 * np.maximum(product, 0.0)
        return sp.diags(self.volumes * convex).tocsr()


def smoothed_median(field: Field, weights: Field, edge: float) -> float:
    """Return the level c that minimises the sum of weights * sqrt((field - c)^2 + edge^2).

    It is the weighted median where `edge` is small relative to the spread. The sum is strictly
    convex in c, so that its slope has one root.
    """

    def slope(level: float) -> float:
        difference = field - level
        return float(weights @ (difference / np.hypot(difference, edge)))

    return float(brentq(slope, field.min(), field.max(), xtol=_LEVEL_TOLERANCE))


def two_levels(field: Field, weights: Field) -> tuple[float, float]:
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

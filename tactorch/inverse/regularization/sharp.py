"""Penalties that keep sharp contrasts, minimised by reweighted least squares.

Their cost grows more slowly than the square of a difference: of the log-moduli across an interior
face (total variation, logarithm of jumps), or of a log-modulus from a background (sparsity).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float

from tactorch.config import option
from tactorch.inverse.regularization.base import Prior, Regularizer, jumps, relative
from tactorch.mesh import TetMesh
from tactorch.metrics.segment import weighted_median

_MAX_BISECTIONS, _LEVEL_TOLERANCE = 200, 1e-12
_Function = Callable[[np.ndarray], np.ndarray]


class _ReweightedPenalty(Regularizer):
    """Sum of weight * cost(difference), with difference = matrix (field - level).

    The curvature at a field belongs to the quadratic majorant that touches the penalty there. It
    exists where the cost is concave in the squared difference. A level that depends on the field
    minimises the penalty, so that it adds nothing to the gradient (envelope theorem).
    """

    def __init__(
        self,
        matrix: sp.csr_matrix,
        weights: Float[np.ndarray, " n"],
        cost: _Function,
        stiffness: _Function,  # derivative of the cost by the difference, over the difference
        level: Callable[[np.ndarray], float] = lambda _: 0.0,
    ) -> None:
        self._matrix, self._weights, self._level = matrix, weights, level
        self._cost, self._stiffness = cost, stiffness

    def _difference(self, field: np.ndarray) -> np.ndarray:
        return self._matrix @ (field - self._level(field))

    def value(self, field: Float[np.ndarray, " m"]) -> float:
        return float(self._weights @ self._cost(self._difference(field)))

    def gradient(self, field: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        difference = self._difference(field)
        return self._matrix.T @ (self._weights * self._stiffness(difference) * difference)

    def curvature(self, field: Float[np.ndarray, " m"]) -> sp.csr_matrix:
        weights = sp.diags(self._weights * self._stiffness(self._difference(field)))
        return (self._matrix.T @ weights @ self._matrix).tocsr()


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
        """Return the penalty on a mesh."""
        areas = relative(mesh.adjacency.areas)
        penalty = _ReweightedPenalty(jumps(mesh), areas, *_smoothed_size(self.edge))
        penalty.variation_edge = self.edge
        return penalty


@dataclass(frozen=True, kw_only=True)
class LogJumps(Prior):
    """Logarithm of jumps: keeps contrast better than total variation, but is not convex.

    Sum over interior faces of area * edge * log(1 + (jump / edge)^2), in mean areas: the
    Lorentzian of Black and Rangarajan (1996). Its force on a jump falls as the jump grows.
    """

    edge: float = option(0.1, "Jump of log-modulus at which the force is largest", gt=0)

    def on(self, mesh: TetMesh) -> Regularizer:
        """Return the penalty on a mesh."""
        edge = self.edge
        return _ReweightedPenalty(
            jumps(mesh),
            relative(mesh.adjacency.areas),
            lambda jump: edge * np.log1p((jump / edge) ** 2),
            lambda jump: 2.0 * edge / (edge**2 + jump * jump),
        )


@dataclass(frozen=True, kw_only=True)
class Sparsity(Prior):
    """Sparsity: few elements differ from a background modulus, possibly by much.

    Sum over elements of volume * (sqrt((log E - background)^2 + edge^2) - edge), in mean volumes.
    The median of the present map is that of the log-moduli by volume, smoothed like the penalty,
    which it minimises.
    """

    edge: float = option(
        0.03, "Difference of log-modulus below which the penalty is quadratic", gt=0
    )
    level_mpa: float | None = option(
        None, "Background modulus; null: the median of the present map", unit="MPa", gt=0
    )

    def on(self, mesh: TetMesh) -> Regularizer:
        """Return the penalty on a mesh."""
        volumes, known = relative(mesh.volumes), self.level_mpa and float(np.log(self.level_mpa))

        def level(field: np.ndarray) -> float:
            return smoothed_median(field, volumes, self.edge) if known is None else known

        matrix = sp.identity(mesh.n_tets, format="csr")
        return _ReweightedPenalty(matrix, volumes, *_smoothed_size(self.edge), level)


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

"""The linearised problem at one point, solved for every weight of the prior at once.

Near x the map minimises 1/2 |r + J d|^2 + w (1/2 d^T P d + g^T d). With P = L L^T and
J L^-T = U S V^T everything is diagonal, and one decomposition serves all weights (Golub, Heath and
Wahba, 1979; Hansen, 1998).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.linalg as la
import scipy.sparse as sp
from jaxtyping import Float

from tactorch.inverse.fit.objective import Point

# Shift of directions that the prior leaves free (a uniform change), relative to its mean diagonal.
_SHIFT = 1e-6
_DECADES, _PER_DECADE = 8, 8


@dataclass(frozen=True, eq=False)
class Spectrum:
    """The linearised problem in the coordinates where it is diagonal."""

    squares: Float[np.ndarray, " k"]  # squared singular values S^2
    pull: Float[np.ndarray, " k"]  # S U^T r
    push: Float[np.ndarray, " k"]  # V^T L^-1 g
    misfit: float  # |r|^2 at the point
    n_data: int

    @staticmethod
    def at(point: Point) -> "Spectrum | None":
        """Decompose at a point, for the map alone; None where the prior cannot be factored."""
        m = len(point.youngs)
        gradient, curvature = point.penalty_gradient[:m], point.penalty_curvature[:m, :m]
        return Spectrum.of(point.jacobian[:, :m], point.evaluation.residuals, curvature, gradient)

    @staticmethod
    def of(
        jacobian: Float[np.ndarray, "p m"],
        residuals: Float[np.ndarray, " p"],
        curvature: sp.csr_matrix,
        gradient: Float[np.ndarray, " m"],
    ) -> "Spectrum | None":
        """Decompose J, r, P, g; None where P with a small shift cannot be factored."""
        prior = curvature.toarray()
        prior[np.diag_indices_from(prior)] += _SHIFT * prior.trace() / len(prior)
        try:
            factor = la.cholesky(prior, lower=True, overwrite_a=True, check_finite=False)
            values, vectors = _right_vectors(jacobian, factor)
        except la.LinAlgError:
            return None
        slope = la.solve_triangular(factor, jacobian.T @ residuals, lower=True)
        push = la.solve_triangular(factor, gradient, lower=True)
        misfit = float(residuals @ residuals)
        return Spectrum(values, vectors.T @ slope, vectors.T @ push, misfit, len(residuals))

    def weights(self) -> Float[np.ndarray, " w"]:
        """Return candidate weights, from the largest squared singular value down."""
        exponents = np.linspace(0.0, -_DECADES, _DECADES * _PER_DECADE + 1)
        return float(self.squares.max()) * 10.0**exponents

    def _steps(self, weights: np.ndarray) -> np.ndarray:
        w = weights[:, None]
        return -(self.pull + w * self.push) / (self.squares + w)

    def misfits(self, weights: Float[np.ndarray, " w"]) -> Float[np.ndarray, " w"]:
        """Return the squared residuals |r + J d|^2 at each weight."""
        steps = self._steps(weights)
        left = self.misfit + 2.0 * steps @ self.pull + (steps * steps) @ self.squares
        return np.maximum(left, np.finfo(float).tiny)

    def penalties(self, weights: Float[np.ndarray, " w"]) -> Float[np.ndarray, " w"]:
        """Return the prior's quadratic above its minimum, without its weight, at each weight."""
        left = self._steps(weights) + self.push
        return np.maximum(0.5 * (left * left).sum(axis=1), np.finfo(float).tiny)

    def freedom(self, weights: Float[np.ndarray, " w"]) -> Float[np.ndarray, " w"]:
        """Return the degrees of freedom at each weight: the trace of the influence matrix."""
        return (self.squares / (self.squares + weights[:, None])).sum(axis=1)


def _right_vectors(jacobian: np.ndarray, factor: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """S^2 and V of J L^-T, through the smaller of J L^-T and its transpose."""
    scaled = la.solve_triangular(factor, jacobian.T, lower=True)  # (J L^-T)^T, m x p
    m, p = scaled.shape
    if p >= m:
        values, vectors = la.eigh(scaled @ scaled.T, driver="evd", check_finite=False)
        return np.maximum(values, 0.0), vectors
    values, left = la.eigh(scaled.T @ scaled, driver="evd", check_finite=False)
    determined = values > 1e-12 * values[-1]
    vectors = scaled @ left[:, determined] / np.sqrt(values[determined])
    return values[determined], vectors


def gcv_score(spectrum: Spectrum, weights: Float[np.ndarray, " w"]) -> Float[np.ndarray, " w"]:
    """Return the mean squared residual over (1 - freedom / data)^2 for each weight."""
    left = 1.0 - spectrum.freedom(weights) / spectrum.n_data
    return spectrum.misfits(weights) / spectrum.n_data / np.maximum(left, 1e-9) ** 2


def gcv_weight(spectrum: Spectrum) -> float:
    """Return the weight with the lowest score of generalised cross-validation."""
    weights = spectrum.weights()
    return float(weights[np.argmin(gcv_score(spectrum, weights))])


def l_curve_weight(spectrum: Spectrum) -> float:
    """Return the weight of largest curvature of log misfit against log prior."""
    weights = spectrum.weights()
    across, up = np.log(spectrum.misfits(weights)), np.log(spectrum.penalties(weights))
    dx, dy = np.gradient(across), np.gradient(up)
    ddx, ddy = np.gradient(dx), np.gradient(dy)
    curvature = (dy * ddx - dx * ddy) / np.maximum((dx * dx + dy * dy) ** 1.5, 1e-30)
    # Where the curve hardly moves, its curvature is round-off; the ends have none.
    curvature[dx * dx + dy * dy < 1e-6] = -np.inf
    inner = slice(2, -2)
    return float(weights[inner][np.argmax(curvature[inner])])


RULES: dict[str, Callable[[Spectrum], float]] = {"l_curve": l_curve_weight, "gcv": gcv_weight}

"""Gaussian (Laplace) approximation of the posterior at a solution, by dense algebra.

The precision is H = J^T J + weight * Q, with J the sensitivity of the residuals (in standard
deviations) and Q the prior's curvature, both in parameters x. Memory is two m x m matrices: fit
for a few thousand elements. Total variation is stood for by its quadratic majorant at the map.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
import torch
from jaxtyping import Float, Int
from scipy.special import ndtri

from tactorch.errors import ConfigError
from tactorch.inverse import Parameterization, Point
from tactorch.linalg import DenseCholesky


@dataclass(frozen=True, eq=False)
class LaplacePosterior:
    """A normal distribution of the parameters x.

    Attributes:
        mean: Parameters at the solution, elements only.
        jacobian: D residuals / d x; columns beyond the elements are global unknowns.
        factor: Cholesky factor of the precision, as wide as the Jacobian.
        parameterization: What x means.
    """

    mean: Float[np.ndarray, " m"]
    jacobian: Float[np.ndarray, "data unknowns"]
    factor: DenseCholesky
    parameterization: Parameterization

    @staticmethod
    def at(point: Point, weight: float) -> "LaplacePosterior":
        """Take the posterior at a point of the objective.

        Args:
            point: The solution.
            weight: Weight of the prior there.

        Raises:
            ConfigError: the weight is negative, or data and prior leave something undetermined.
        """
        return LaplacePosterior.of(
            point.x,
            point.jacobian,
            weight,
            point.penalty_curvature,
            point.objective.parameterization,
        )

    @staticmethod
    def of(
        mean: Float[np.ndarray, " m"],
        jacobian: Float[np.ndarray, "data unknowns"],
        weight: float,
        prior: sp.csr_matrix,
        parameterization: Parameterization,
    ) -> "LaplacePosterior":
        """Take the posterior of a linear model; see `at`."""
        if not weight >= 0:
            raise ConfigError(f"weight={weight} of the prior must be 0 or more.")
        precision = jacobian.T @ jacobian
        coo = prior.tocoo()
        np.add.at(precision, (coo.row, coo.col), weight * coo.data)
        factor = DenseCholesky.of(precision)
        if factor is None:
            raise ConfigError(
                f"weight={weight}: data and prior leave some moduli undetermined, so the posterior "
                "has no finite width; give a prior and a larger weight."
            )
        return LaplacePosterior(mean, jacobian, factor, parameterization)

    @cached_property
    def _covariance(self) -> Float[np.ndarray, "unknowns unknowns"]:
        return torch.cholesky_inverse(self.factor.lower).numpy()

    def variance(self) -> Float[np.ndarray, " m"]:
        """Return the variance of each element's parameter."""
        return self._covariance.diagonal()[: len(self.mean)].copy()

    def deviation(self) -> Float[np.ndarray, " m"]:
        """Return the standard deviation of each element's parameter."""
        return np.sqrt(self.variance())

    def interval(
        self, level: float = 0.95
    ) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
        """Return lower and upper moduli (MPa) that hold each element's with this probability.

        The ends are those of the normal interval of x, turned into moduli and cut to the bounds.

        Raises:
            ConfigError: `level` is not between 0 and 1.
        """
        if not 0 < level < 1:
            raise ConfigError(f"level={level} must lie between 0 and 1, such as 0.95.")
        reach = float(ndtri(0.5 + 0.5 * level)) * self.deviation()
        limits = self.parameterization.limits
        low, high = (np.clip(self.mean + sign * reach, *limits) for sign in (-1, 1))
        return self.parameterization.youngs(low), self.parameterization.youngs(high)

    def covariance(self, elements: Int[np.ndarray, " k"]) -> Float[np.ndarray, "k k"]:
        """Return the covariance of some elements' parameters."""
        return self._covariance[np.ix_(elements, elements)]

    def correlation(self, elements: Int[np.ndarray, " k"]) -> Float[np.ndarray, "k k"]:
        """Return the correlation of some elements' parameters."""
        covariance = self.covariance(elements)
        deviation = np.sqrt(covariance.diagonal())
        return covariance / np.outer(deviation, deviation)

    def resolution_diagonal(self) -> Float[np.ndarray, " m"]:
        """Return diag(H^-1 J^T J): near 1 where the data decide, near 0 where the prior does."""
        seen = self._covariance[: len(self.mean)] @ self.jacobian.T
        return np.einsum("mp,pm->m", seen, self.jacobian[:, : len(self.mean)])

    def sample(self, rng: np.random.Generator, n: int) -> Float[np.ndarray, "n m"]:
        """Draw parameters, one map a row."""
        noise = torch.from_numpy(rng.standard_normal((self.jacobian.shape[1], n)))
        drawn = torch.linalg.solve_triangular(self.factor.lower.T, noise, upper=True).numpy()
        return self.mean + drawn[: len(self.mean)].T

    def log_det(self) -> float:
        """Return the logarithm of the determinant of the precision H."""
        return 2.0 * float(torch.log(torch.diagonal(self.factor.lower)).sum())

"""Gaussian posteriors, and the Laplace approximation at a solution by dense algebra.

The precision is H = J^T J + P, with J the sensitivity of the residuals (in standard deviations)
and P the prior's weighted curvature, both in parameters x. Memory is two m x m matrices, suitable
for a few thousand elements; `LowRankPosterior` is for larger meshes. Total variation is
approximated by its quadratic majorant at the map; `variational_posterior` estimates its scales.
"""

from abc import ABC, abstractmethod
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

Field = Float[np.ndarray, " m"]  # a value per element


class GaussianPosterior(ABC):
    """Normal distribution of the parameters x, one per element.

    Attributes:
        mean: Mean.
        parameterization: Map from x to moduli.
    """

    mean: Field
    parameterization: Parameterization

    @abstractmethod
    def variance(self) -> Field:
        """Return the variance of each element's parameter."""

    @abstractmethod
    def covariance(self, elements: Int[np.ndarray, " k"]) -> Float[np.ndarray, "k k"]:
        """Return the covariance of some elements' parameters."""

    @abstractmethod
    def resolution_diagonal(self) -> Field:
        """Return diag(H^-1 J^T J): near 1 where data dominate, near 0 where the prior does."""

    @abstractmethod
    def sample(self, rng: np.random.Generator, n: int) -> Float[np.ndarray, "n m"]:
        """Draw parameters, one map per row."""

    @abstractmethod
    def log_det(self) -> float:
        """Return the logarithm of the determinant of the precision H."""

    def deviation(self) -> Field:
        """Return the standard deviation of each element's parameter."""
        return np.sqrt(self.variance())

    def interval(self, level: float = 0.95) -> tuple[Field, Field]:
        """Return the central interval of each element's modulus, (lower, upper), MPa.

        It is the normal interval of x with probability `level`, mapped to moduli and clipped to
        the bounds.
        """
        half_width = normal_quantile(level) * self.deviation()
        limits = self.parameterization.limits
        low, high = (np.clip(self.mean + sign * half_width, *limits) for sign in (-1, 1))
        return self.parameterization.youngs(low), self.parameterization.youngs(high)

    def correlation(self, elements: Int[np.ndarray, " k"]) -> Float[np.ndarray, "k k"]:
        """Return the correlation of some elements' parameters."""
        covariance = self.covariance(elements)
        deviation = np.sqrt(covariance.diagonal())
        return covariance / np.outer(deviation, deviation)


@dataclass(frozen=True, eq=False)
class LaplacePosterior(GaussianPosterior):
    """Normal distribution of the parameters x, with a dense precision.

    Attributes:
        jacobian: D residuals / d x; columns beyond the elements are nuisance parameters.
        factor: Cholesky factor of the precision, with as many rows as the Jacobian has columns.
    """

    mean: Field
    jacobian: Float[np.ndarray, "data unknowns"]
    factor: DenseCholesky
    parameterization: Parameterization

    @staticmethod
    def at(point: Point, weight: float) -> "LaplacePosterior":
        """Return the posterior at a point of the objective.

        Nuisance parameters are marginalised: their uncertainty widens the elements' deviations.

        Raises:
            ConfigError: the weight is negative, or data and prior leave moduli undetermined.
        """
        check_weight(weight)
        prior = point.prior_curvature(weight)
        parameterization = point.objective.elements.parameterization
        return LaplacePosterior.of(point.coefficients, point.jacobian, prior, parameterization)

    @staticmethod
    def of(
        mean: Field,
        jacobian: Float[np.ndarray, "data unknowns"],
        prior: sp.spmatrix | sp.sparray,
        parameterization: Parameterization,
    ) -> "LaplacePosterior":
        """Return the posterior of a linear model with this precision of the prior; see `at`."""
        factor = DenseCholesky.of(jacobian.T @ jacobian, prior)
        if factor is None:
            raise ConfigError(
                "data and prior leave some moduli undetermined; give a prior and a larger weight."
            )
        return LaplacePosterior(mean, jacobian, factor, parameterization)

    @cached_property
    def _covariance(self) -> Float[np.ndarray, "unknowns unknowns"]:
        return torch.cholesky_inverse(self.factor.lower).numpy()

    def variance(self) -> Field:
        return self._covariance.diagonal()[: len(self.mean)].copy()

    def covariance(self, elements: Int[np.ndarray, " k"]) -> Float[np.ndarray, "k k"]:
        return self._covariance[np.ix_(elements, elements)]

    def resolution_diagonal(self) -> Field:
        gain = self._covariance[: len(self.mean)] @ self.jacobian.T
        return np.einsum("mp,pm->m", gain, self.jacobian[:, : len(self.mean)])

    def sample(self, rng: np.random.Generator, n: int) -> Float[np.ndarray, "n m"]:
        noise = torch.from_numpy(rng.standard_normal((self.jacobian.shape[1], n)))
        sample = torch.linalg.solve_triangular(self.factor.lower.T, noise, upper=True).numpy()
        return self.mean + sample[: len(self.mean)].T

    def log_det(self) -> float:
        return 2.0 * float(torch.log(torch.diagonal(self.factor.lower)).sum())


def normal_quantile(level: float) -> float:
    """Return half the width of the central normal interval of a level, in standard deviations."""
    if not 0 < level < 1:
        raise ConfigError(f"level={level} must lie between 0 and 1, such as 0.95.")
    return float(ndtri(0.5 + 0.5 * level))


def check_weight(weight: float) -> None:
    """Raise ConfigError for a negative or undefined weight of the prior."""
    if not weight >= 0:
        raise ConfigError(f"weight={weight} of the prior must be 0 or more.")

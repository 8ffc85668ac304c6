"""Interface of normal posteriors, dense or of low rank."""

from abc import ABC, abstractmethod

import numpy as np
from jaxtyping import Float, Int
from scipy.special import ndtri

from tactorch.errors import ConfigError
from tactorch.inverse import Parameterization


class GaussianPosterior(ABC):
    """Normal distribution of the parameters x, one per element.

    Attributes:
        mean: Mean.
        parameterization: Map from x to moduli.
    """

    mean: Float[np.ndarray, " m"]
    parameterization: Parameterization

    @abstractmethod
    def variance(self) -> Float[np.ndarray, " m"]:
        """Return the variance of each element's parameter."""

    @abstractmethod
    def covariance(self, elements: Int[np.ndarray, " k"]) -> Float[np.ndarray, "k k"]:
        """Return the covariance of some elements' parameters."""

    @abstractmethod
    def resolution_diagonal(self) -> Float[np.ndarray, " m"]:
        """Return diag(H^-1 J^T J): near 1 where data dominate, near 0 where the prior does."""

    @abstractmethod
    def sample(self, rng: np.random.Generator, n: int) -> Float[np.ndarray, "n m"]:
        """Draw parameters, one map per row."""

    @abstractmethod
    def log_det(self) -> float:
        """Return the logarithm of the determinant of the precision H."""

    def deviation(self) -> Float[np.ndarray, " m"]:
        """Return the standard deviation of each element's parameter."""
        return np.sqrt(self.variance())

    def interval(
        self, level: float = 0.95
    ) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
        """Return the central interval of each element's modulus, (lower, upper), MPa.

        It is the normal interval of x, mapped to moduli and clipped to the bounds.

        Args:
            level: Probability of the interval.

        Returns:
            Lower and upper moduli, MPa.

        Raises:
            ConfigError: `level` is not between 0 and 1.
        """
        if not 0 < level < 1:
            raise ConfigError(f"level={level} must lie between 0 and 1, such as 0.95.")
        half_width = float(ndtri(0.5 + 0.5 * level)) * self.deviation()
        limits = self.parameterization.limits
        low, high = (np.clip(self.mean + sign * half_width, *limits) for sign in (-1, 1))
        return self.parameterization.youngs(low), self.parameterization.youngs(high)

    def correlation(self, elements: Int[np.ndarray, " k"]) -> Float[np.ndarray, "k k"]:
        """Return the correlation of some elements' parameters."""
        covariance = self.covariance(elements)
        deviation = np.sqrt(covariance.diagonal())
        return covariance / np.outer(deviation, deviation)

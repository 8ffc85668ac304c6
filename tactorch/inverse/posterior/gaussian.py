"""The normal posterior of an element map."""

from abc import ABC, abstractmethod

import numpy as np
from jaxtyping import Float, Int

from tactorch.inverse.fields.parameterization import Parameterization
from tactorch.metrics.coverage import normal_quantile

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

    def deviation(self) -> Field:
        """Return the standard deviation of each element's parameter."""
        return np.sqrt(self.variance())

    def interval(self, level: float = 0.9) -> tuple[Field, Field]:
        """Return the central interval of each element's modulus, (lower, upper), MPa.

        It is the normal interval of x with probability `level`, mapped to moduli and clipped to
        the bounds.
        """
        half_width = normal_quantile(level) * self.deviation()
        limits = self.parameterization.limits
        low, high = (np.clip(self.mean + sign * half_width, *limits) for sign in (-1, 1))
        return self.parameterization.youngs(low), self.parameterization.youngs(high)

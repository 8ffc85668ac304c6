"""Gaussian state of the moduli and its update by a press (Section V-C)."""

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sl
from jaxtyping import Float

from tactorch.errors import ConfigError


@dataclass(frozen=True, eq=False)
class GaussianState:
    """A normal distribution of one number an element.

    Attributes:
        mean: Of each element.
        covariance: Between elements, dense and positive definite.
    """

    mean: Float[np.ndarray, " m"]
    covariance: Float[np.ndarray, "m m"]

    def deviation(self) -> Float[np.ndarray, " m"]:
        """Return the standard deviation of each element."""
        return np.sqrt(self.covariance.diagonal())

    def after_map(
        self, observed: Float[np.ndarray, " m"], credibility: Float[np.ndarray, " m"]
    ) -> "GaussianState":
        """Join the map of one press by itself, as the paper does (eq. 16 and 17).

        R is diagonal with 1 / credibility. Solved in the data's space, so that elements of
        credibility 0 keep their state.

        Args:
            observed: The map of the press, in the unit of the mean.
            credibility: Of each element, in the inverse square of that unit, at least 0.

        Raises:
            ConfigError: lengths differ, or a credibility is negative or not finite.
        """
        if not len(observed) == len(credibility) == len(self.mean):
            raise ConfigError(
                f"observed has {len(observed)} elements and credibility {len(credibility)}, but "
                f"the belief {len(self.mean)}; give one each."
            )
        if not (np.isfinite(credibility).all() and (credibility >= 0).all()):
            raise ConfigError("credibility must be finite and at least 0 everywhere.")
        felt = credibility > 0
        rows = np.diag(np.sqrt(credibility))[felt]
        return self.after_press(rows, rows @ (observed - self.mean))

    def after_press(
        self, jacobian: Float[np.ndarray, "data m"], innovation: Float[np.ndarray, " data"]
    ) -> "GaussianState":
        """Join the data of one press, linear around the mean: a rank update of the covariance.

        Args:
            jacobian: Derivative of the press's displacements, in standard deviations of the noise.
            innovation: Measured minus predicted at the mean, in the same.

        Raises:
            ConfigError: shapes do not fit.
        """
        self._check(jacobian)
        if len(innovation) != len(jacobian):
            raise ConfigError(
                f"innovation has {len(innovation)} values for {len(jacobian)} rows of the jacobian."
            )
        cross = jacobian @ self.covariance
        lower = sl.cholesky(np.eye(len(jacobian)) + cross @ jacobian.T, lower=True)
        half = sl.solve_triangular(lower, cross, lower=True)
        seen = sl.solve_triangular(lower, innovation, lower=True)
        return GaussianState(self.mean + half.T @ seen, self.covariance - half.T @ half)

    def information_gain(self, jacobian: Float[np.ndarray, "data m"]) -> float:
        """Return what a press is expected to tell: log det(I + J Sigma J^T) / 2, in nats.

        It is the mutual information of moduli and data, so it needs no data.

        Raises:
            ConfigError: the jacobian has another number of columns than there are elements.
        """
        self._check(jacobian)
        spread = np.eye(len(jacobian)) + jacobian @ self.covariance @ jacobian.T
        return float(np.log(sl.cholesky(spread, lower=True).diagonal()).sum())

    def expected_variance_reduction(
        self, jacobian: Float[np.ndarray, "data m"]
    ) -> Float[np.ndarray, " m"]:
        """Return by how much a press is to lower the variance of each element; it needs no data.

        Raises:
            ConfigError: the jacobian has another number of columns than there are elements.
        """
        self._check(jacobian)
        cross = jacobian @ self.covariance
        lower = sl.cholesky(np.eye(len(jacobian)) + cross @ jacobian.T, lower=True)
        half = sl.solve_triangular(lower, cross, lower=True)
        return np.square(half).sum(axis=0)

    def _check(self, jacobian: np.ndarray) -> None:
        if jacobian.shape[1] != len(self.mean):
            raise ConfigError(
                f"jacobian has {jacobian.shape[1]} columns for {len(self.mean)} elements."
            )

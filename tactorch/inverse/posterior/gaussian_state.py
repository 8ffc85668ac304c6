"""Normal distribution of the moduli between presses, and its update by a press (Section V-C)."""

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sl
from jaxtyping import Float

from tactorch.errors import ConfigError


@dataclass(frozen=True, eq=False)
class GaussianState:
    """Normal distribution with one parameter per element.

    Attributes:
        mean: Mean.
        covariance: Dense positive definite covariance.
    """

    mean: Float[np.ndarray, " m"]
    covariance: Float[np.ndarray, "m m"]

    def deviation(self) -> Float[np.ndarray, " m"]:
        """Return the standard deviation of each element."""
        return np.sqrt(self.covariance.diagonal())

    def after_press(
        self, jacobian: Float[np.ndarray, "data m"], innovation: Float[np.ndarray, " data"]
    ) -> "GaussianState":
        """Update by the data of a press, linearised at the mean (Kalman update, eq. 16 and 17).

        With the diagonal R of the paper the Jacobian is diagonal: the roots of the credibilities.

        Args:
            jacobian: Derivative of the data, in standard deviations of the noise.
            innovation: Observed minus predicted data at the mean, in the same unit.
        """
        if len(innovation) != len(jacobian):
            raise ConfigError(
                f"innovation has {len(innovation)} values for {len(jacobian)} rows of the jacobian."
            )
        lower, cross = self._factor(jacobian)
        half_gain = sl.solve_triangular(lower, cross, lower=True)
        mean = self.mean + half_gain.T @ sl.solve_triangular(lower, innovation, lower=True)
        return GaussianState(mean, self.covariance - half_gain.T @ half_gain)

    def information_gain(self, jacobian: Float[np.ndarray, "data m"]) -> float:
        """Return the mutual information of moduli and data, log det(I + J Sigma J^T) / 2, nats.

        See `after_press` for the jacobian.
        """
        lower, _ = self._factor(jacobian)
        return float(np.log(lower.diagonal()).sum())

    def expected_variance_reduction(
        self, jacobian: Float[np.ndarray, "data m"]
    ) -> Float[np.ndarray, " m"]:
        """Return the reduction of each element's variance by a press, before its data.

        See `after_press` for the jacobian.
        """
        lower, cross = self._factor(jacobian)
        return np.square(sl.solve_triangular(lower, cross, lower=True)).sum(axis=0)

    def _factor(self, jacobian: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Cholesky factor L of I + J Sigma J^T, and J Sigma."""
        if jacobian.shape[1] != len(self.mean):
            raise ConfigError(
                f"jacobian has {jacobian.shape[1]} columns for {len(self.mean)} elements."
            )
        cross = jacobian @ self.covariance
        return sl.cholesky(np.eye(len(jacobian)) + cross @ jacobian.T, lower=True), cross

"""The Laplace approximation of the posterior at a solution, by dense algebra.

The precision is H = J^T J + P, with J the sensitivity of the residuals (in standard deviations)
and P the prior's weighted curvature, both in parameters x. Memory is two m x m matrices, suitable
for a few thousand elements; `LowRankPosterior` is for larger meshes. Total variation is
approximated by its quadratic majorant at the map; `variational_posterior` estimates its scales.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
import torch
from jaxtyping import Float, Int

from tactorch.errors import ConfigError
from tactorch.inverse.fields.parameterization import Parameterization
from tactorch.inverse.fit.objective import Point
from tactorch.inverse.posterior.gaussian import Field, GaussianPosterior
from tactorch.linalg import DenseCholesky


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
        return self.factor.inverse()

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


def check_weight(weight: float) -> None:
    """Raise ConfigError for a negative or undefined weight of the prior."""
    if not weight >= 0:
        raise ConfigError(f"weight={weight} of the prior must be 0 or more.")

"""Estimates of the nuisance parameters with their standard deviations."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConvergenceError, TactorchError
from tactorch.inverse.objective import Point
from tactorch.linalg import DenseCholesky

_MAX_RATIO = 0.9  # of posterior to prior deviation, for informative data
_MAX_DENSE = 12_000  # parameters up to which the normal matrix (1.2 GB) is formed


@dataclass(frozen=True, eq=False)
class NuisanceEstimate:
    """Estimate of one nuisance parameter.

    Attributes:
        value: Its components.
        deviation: Their posterior standard deviations, relative for scales; NaN where the problem
            is too large for a dense matrix, or an equilibrium is unstable.
        prior_deviation: Their prior standard deviation.
    """

    value: Float[np.ndarray, " c"]
    deviation: Float[np.ndarray, " c"]
    prior_deviation: float

    @property
    def is_informative(self) -> bool:
        """Whether the data reduce the deviation of some component by a tenth or more."""
        return bool((self.deviation < _MAX_RATIO * self.prior_deviation).any())

    def plain(self) -> dict[str, Any]:
        """Return the estimate as plain JSON values."""
        return {
            "value": self.value.tolist(),
            "deviation": self.deviation.tolist(),
            "prior_deviation": self.prior_deviation,
        }

    @staticmethod
    def of(plain: dict[str, Any]) -> "NuisanceEstimate":
        """Return the estimate from plain JSON values."""
        value, deviation = np.array(plain["value"]), np.array(plain["deviation"])
        return NuisanceEstimate(value, deviation, plain["prior_deviation"])


def estimates(point: Point, weight: float) -> dict[str, NuisanceEstimate]:
    """Return the nuisance parameters of a solution, by name; empty where none is estimated.

    Deviations are those of the Laplace approximation with the map unknown too.

    Args:
        point: The solution.
        weight: Weight of the prior.
    """
    priors = point.objective.nuisance
    if not priors.size:
        return {}
    deviations = priors.parts(priors.slopes() * _deviation_of_z(point, weight))
    return {
        name: NuisanceEstimate(
            np.atleast_1d(getattr(point.evaluation.nuisance, name)),
            deviations[name],
            getattr(priors, name),
        )
        for name in priors.names
    }


def _deviation_of_z(point: Point, weight: float) -> Float[np.ndarray, " k"]:
    k = len(point.z)
    if len(point.x) > _MAX_DENSE:
        return np.full(k, np.nan)
    try:
        precision = point.jacobian.T @ point.jacobian
    except ConvergenceError:  # an unstable equilibrium, at which the search has ended
        return np.full(k, np.nan)
    coo = point.prior_curvature(weight).tocoo()
    np.add.at(precision, (coo.row, coo.col), coo.data)
    # Elements that neither data nor prior determine would break the factorisation; the shift has
    # no visible effect on the variances of z.
    precision[np.diag_indices_from(precision)] += 1e-12 * precision.diagonal().max()
    factor = DenseCholesky.of(precision)
    if factor is None:
        raise TactorchError("the posterior of the nuisance parameters is not definite")
    columns = np.zeros((len(point.x), k))
    columns[-k:] = np.eye(k)
    covariance = np.column_stack([factor.solve(column) for column in columns.T])
    return np.sqrt(covariance[-k:].diagonal())

"""Choice of the posterior by prior and size of the problem."""

from tactorch.inverse.fit.objective import Point
from tactorch.inverse.posterior.gaussian import GaussianPosterior
from tactorch.inverse.posterior.laplace import LaplacePosterior
from tactorch.inverse.posterior.low_rank import LowRankPosterior
from tactorch.inverse.posterior.variational import has_variational_posterior, variational_posterior

MAX_VARIATIONAL, MAX_DENSE = 2_000, 12_000  # parameters, limited by time and by memory


def posterior_at(point: Point, weight: float) -> GaussianPosterior:
    """Return the posterior at a point of the objective, with this weight of the prior."""
    size = point.objective.size
    if size <= MAX_VARIATIONAL and has_variational_posterior(point, weight):
        return variational_posterior(point, weight)
    return (LaplacePosterior if size <= MAX_DENSE else LowRankPosterior).at(point, weight)

"""Posteriors of element maps and inclusions, and the paper's credibility.

`tactorch.inverse.compute_posterior` chooses among `LaplacePosterior`, `LowRankPosterior` (large
meshes) and `variational_posterior` (total variation, with estimated scales).
"""

from tactorch.inverse.posterior.gaussian import GaussianPosterior
from tactorch.inverse.posterior.gaussian_state import GaussianState
from tactorch.inverse.posterior.laplace import LaplacePosterior
from tactorch.inverse.posterior.low_rank import LowRankPosterior
from tactorch.inverse.posterior.select import posterior_at
from tactorch.inverse.posterior.sensitivity import credibility, layer_profile
from tactorch.inverse.posterior.variational import VariationalPosterior, variational_posterior

__all__ = [
    "GaussianPosterior",
    "GaussianState",
    "LaplacePosterior",
    "LowRankPosterior",
    "VariationalPosterior",
    "credibility",
    "layer_profile",
    "posterior_at",
    "variational_posterior",
]

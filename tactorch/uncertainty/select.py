"""Choice of the posterior by prior and size of the problem."""

from tactorch.errors import TactorchError
from tactorch.inverse import Point, Reconstruction, Settings
from tactorch.inverse.invert import solution
from tactorch.inverse.posterior.gaussian import GaussianPosterior
from tactorch.recording import Recording
from tactorch.uncertainty.laplace import LaplacePosterior
from tactorch.uncertainty.low_rank import LowRankPosterior
from tactorch.uncertainty.variational import has_variational_posterior, variational_posterior

#: Errors of a posterior that cannot be computed; on large problems also of NumPy, torch, ARPACK.
UNCOMPUTABLE = (TactorchError, MemoryError, RuntimeError)
MAX_VARIATIONAL, MAX_DENSE = 2_000, 12_000  # parameters, limited by time and by memory


def compute_posterior(
    recording: Recording, reconstruction: Reconstruction, settings: Settings | None = None
) -> GaussianPosterior:
    """Return the posterior of a reconstruction.

    It is `variational_posterior` under total variation up to 2,000 parameters, otherwise
    `LaplacePosterior` up to 12,000, and `LowRankPosterior` beyond.

    Args:
        recording: Presses that were inverted.
        reconstruction: Result of `invert`.
        settings: Settings of the inversion.

    Raises:
        ConfigError: settings and result do not match, or data and prior leave moduli undetermined.
        ConvergenceError: a press has no stable equilibrium at the map.
    """
    point = solution(recording, reconstruction, settings or Settings())
    return posterior_at(point, reconstruction.history[-1].get("weight", 0.0))


def posterior_at(point: Point, weight: float) -> GaussianPosterior:
    """Return the posterior at a point of the objective, with this weight of the prior."""
    size = point.objective.size
    if size <= MAX_VARIATIONAL and has_variational_posterior(point, weight):
        return variational_posterior(point, weight)
    return (LaplacePosterior if size <= MAX_DENSE else LowRankPosterior).at(point, weight)

"""The posterior that fits a reconstruction, its prior and its size."""

from tactorch.errors import TactorchError
from tactorch.inverse import Point, Reconstruction, Settings, solution
from tactorch.recording import Recording
from tactorch.uncertainty.gaussian import GaussianPosterior
from tactorch.uncertainty.laplace import LaplacePosterior
from tactorch.uncertainty.low_rank import LowRankPosterior
from tactorch.uncertainty.variational import has_variational_posterior, variational_posterior

#: What may keep a posterior from being computed: of large problems NumPy, torch or ARPACK, too.
UNCOMPUTABLE = (TactorchError, MemoryError, RuntimeError)
VARIATIONAL, DENSE = 2_000, 12_000  # parameters up to which it takes seconds, or fits the memory


def compute_posterior(
    recording: Recording, found: Reconstruction, settings: Settings | None = None
) -> GaussianPosterior:
    """Return how far each modulus of a reconstruction can be trusted.

    Under total variation that is `variational_posterior`, whose intervals hold; with other priors
    and up to 12,000 elements `LaplacePosterior`; beyond, `LowRankPosterior`, whose deviations are
    never too small by what its rank leaves out.

    Args:
        recording: Presses that were inverted.
        found: What `invert` returned, or `Reconstruction.load` has read.
        settings: Settings of the inversion; the default ones by default.

    Raises:
        ConfigError: settings and result do not fit, or data and prior leave moduli undetermined.
        ConvergenceError: a press has no stable equilibrium at the map.
    """
    point = solution(recording, found, settings or Settings())
    return posterior_at(point, found.history[-1].get("weight", 0.0))


def posterior_at(point: Point, weight: float) -> GaussianPosterior:
    """Return the posterior at a point of the objective, with this weight of the prior."""
    size = point.objective.size
    if size <= VARIATIONAL and has_variational_posterior(point, weight):
        return variational_posterior(point, weight)
    return (
        LaplacePosterior.at(point, weight) if size <= DENSE else LowRankPosterior.at(point, weight)
    )

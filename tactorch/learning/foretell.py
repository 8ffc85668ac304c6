"""A trained surrogate at work: it foretells the map of a recording, to start an inversion from."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float

from tactorch.inverse import Bounds, InverseProblem, Settings
from tactorch.inverse.starts import no_worse_than_uniform
from tactorch.learning.surrogate import Surrogate
from tactorch.learning.touch import Touch, touch
from tactorch.learning.weights import SHIPPED, load_surrogate
from tactorch.mesh import VoxelGrid
from tactorch.recording import Recording


@dataclass(frozen=True, eq=False)
class Foretold:
    """What a surrogate says of an object.

    Attributes:
        youngs: The likeliest modulus of each element, (m,), MPa.
        deviation: Standard deviation of its logarithm, (m,).
    """

    youngs: Float[np.ndarray, " m"]
    deviation: Float[np.ndarray, " m"]


class SurrogateStart:
    """A start foretold by a surrogate; give it to `invert` as `start_mpa`.

    It is refused, with a message, where it fits the presses no better than the best uniform map,
    which then is the start.

    Args:
        weights: A checkpoint of `tactorch train model=surrogate data=warmstart`; None for the
            weights that come with tactorch.

    Raises:
        FileError: The weights are missing, damaged or of another model.
    """

    def __init__(self, weights: str | Path | None = None) -> None:
        self.network = load_surrogate(SHIPPED if weights is None else Path(weights))
        self.__name__ = "surrogate"

    def foretell(self, recording: Recording) -> Foretold:
        """Foretell the map from presses alone; neither truth nor misfit is looked at.

        Raises:
            ConvergenceError: No uniform modulus carries the presses.
        """
        seen = touch(recording, self.network.cells, self.network.frames)
        mean, deviation = answer(self.network, seen)
        grid = VoxelGrid(recording.mesh, 2 * self.network.cells)
        return Foretold(
            seen.youngs_mpa * np.exp(grid.at_elements(mean)),
            np.exp(grid.at_elements(np.log(deviation))),
        )

    def __call__(self, problem: InverseProblem, bounds: Bounds) -> Float[np.ndarray, " m"]:
        """Return the foretold map, or the best uniform one if that fits better.

        Raises:
            ConvergenceError: No uniform modulus carries the presses.
        """
        found = self.foretell(problem.recording)
        return no_worse_than_uniform(found.youngs, problem, bounds, "surrogate")

    def as_prior_mean(self, settings: Settings, recording: Recording) -> Settings:
        """Return settings of an inversion whose prior is about the foretold map.

        What the presses leave open then stays as foretold, with what the network has learnt to
        expect; on objects unlike those that it was trained on, that may mislead.

        Raises:
            ConvergenceError: No uniform modulus carries the presses.
        """
        bounds = settings.bounds
        mean = np.clip(self.foretell(recording).youngs, bounds.lower, bounds.upper)
        return replace(settings, prior=replace(settings.prior, mean_mpa=mean))


def answer(
    network: Surrogate, seen: Touch
) -> tuple[Float[np.ndarray, "w w w"], Float[np.ndarray, "w w w"]]:
    """Return mean and deviation of log E over the uniform modulus, on the grid."""
    presses = torch.from_numpy(seen.presses).float()[None]
    there = torch.ones((1, len(seen.presses)), dtype=torch.bool)
    with torch.inference_mode():
        mean, deviation = network(presses, there, torch.from_numpy(seen.shared).float()[None])
    return mean[0].double().numpy(), deviation[0].double().numpy()

"""Prediction of a map from a recording by a trained surrogate, for initializations."""

import logging
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.inverse import (
    BinaryWell,
    Bounds,
    InverseProblem,
    NoiseModel,
    NoPrior,
    Settings,
    ShiftedPrior,
    homogeneous,
)
from tactorch.inverse.invert import make_objective
from tactorch.inverse.starts import fits_better_than_uniform
from tactorch.learning.surrogate.network import Surrogate
from tactorch.learning.surrogate.touch import Touch, touch
from tactorch.learning.surrogate.weights import SHIPPED, load_surrogate
from tactorch.mesh import VoxelGrid
from tactorch.recording import Recording

_log = logging.getLogger(__name__)
TRUSTED = 10.0  # mean squared residual of a map that explains the presses but for some noise
HALF = 0.5  # of the prior: then the presses decide what of the map they take


@dataclass(frozen=True, eq=False)
class Prediction:
    """What a surrogate says of an object.

    Attributes:
        youngs: The likeliest modulus of each element, (m,), MPa.
        deviation: Standard deviation of its logarithm, (m,).
    """

    youngs: Float[np.ndarray, " m"]
    deviation: Float[np.ndarray, " m"]


class SurrogateStart:
    """Initialization predicted by a surrogate; give it to `invert` as `start_mpa`.

    It is refused, with a message, where it fits the presses no better than the best uniform map,
    which then is the start.

    Args:
        weights: A checkpoint of `tactorch train model=surrogate data=warmstart`; None for the
            weights that come with tactorch. Read when first needed.
    """

    def __init__(self, weights: str | Path | None = None) -> None:
        self.weights = SHIPPED if weights is None else Path(weights)
        self.__name__ = "surrogate"
        self._last: tuple[Recording, NoiseModel | None, Bounds | None, Prediction] | None = None

    def fresh(self) -> "SurrogateStart":
        """Return a copy with the same network and without cached predictions."""
        other = SurrogateStart(self.weights)
        other.network = self.network
        return other

    @cached_property
    def network(self) -> Surrogate:
        """The network.

        Raises:
            FileError: The weights are missing, damaged or of another model.
        """
        return load_surrogate(self.weights)

    def predict(
        self,
        recording: Recording,
        *,
        noise: NoiseModel | None = None,
        bounds: Bounds | None = None,
    ) -> Prediction:
        """Predict the map; the truth and the misfit of the map are not used.

        Args:
            recording: Presses on an object.
            noise: Standard deviations for presses that do not state theirs.
            bounds: Limits of the moduli.

        Raises:
            ConvergenceError: No uniform modulus carries the presses.
            FileError: The weights are missing, damaged or of another model.
        """
        asked = (recording, noise, bounds)
        if self._last is not None and self._last[0] is recording and self._last[1:3] == asked[1:]:
            return self._last[3]
        cells = self.network.cells
        seen = touch(recording, cells, self.network.frames, noise=noise, bounds=bounds)
        mean, deviation = answer(self.network, seen)
        grid, limits = VoxelGrid(recording.mesh, 2 * cells), bounds or Bounds()
        youngs = seen.youngs_mpa * np.exp(grid.at_elements(mean))
        found = Prediction(
            np.clip(youngs, limits.lower, limits.upper),
            np.exp(grid.at_elements(np.log(deviation))),
        )
        self._last = (*asked, found)
        return found

    def __call__(self, problem: InverseProblem, bounds: Bounds) -> Float[np.ndarray, " m"]:
        """Return the predicted map, or the best uniform one if that fits better.

        Raises:
            ConvergenceError: No uniform modulus carries the presses.
            FileError: The weights are missing, damaged or of another model.
        """
        found = self.predict(problem.recording, noise=problem.noise, bounds=bounds).youngs
        taken = fits_better_than_uniform(found, problem, bounds, "surrogate's")
        return found if taken else homogeneous(problem, bounds)

    def as_prior_mean(
        self,
        settings: Settings,
        recording: Recording,
        *,
        most_chi2: float = TRUSTED,
        share: float = HALF,
    ) -> Settings:
        """Return settings of an inversion whose prior is about the predicted map.

        What the presses leave open then remains as predicted, with what the network has learned to
        expect. On objects unlike those that it was trained on that would mislead; such maps do not
        fit the presses, and then, as where the map is refused as a start, the settings stay as
        they are. Where they do fit, the presses decide still: half of the prior is about the map
        and half about nothing, so that total variation makes all maps between a uniform one and the
        predicted one equally likely.

        Args:
            settings: Of the inversion.
            recording: Presses on an object.
            most_chi2: Mean squared residual of the map, in standard deviations, up to which it is
                trusted; infinity trusts any that is not refused.
            share: Of the prior that is about the map, above 0 to 1: with 1 the map stays wherever
                the presses do not speak against it.

        Raises:
            ConfigError: The prior has no use for a mean, or refers to levels; or the share is none.
            ConvergenceError: No uniform modulus carries the presses.
            FileError: The weights are missing, damaged or of another model.
        """
        prior, bounds = settings.regularization, settings.bounds
        if isinstance(prior, NoPrior | BinaryWell) or getattr(prior, "level_mpa", None) is not None:
            raise ConfigError(
                f"a surrogate's map cannot be the mean of {prior}; choose another prior, such as "
                "total_variation, without a level."
            )
        problem = make_objective(recording, settings).problem
        found = self.predict(recording, noise=settings.noise, bounds=bounds).youngs
        if not fits_better_than_uniform(found, problem, bounds, "surrogate's"):
            return settings
        chi2 = problem.evaluate(found).chi2
        if chi2 > most_chi2:
            _log.info(
                "The prior is not about the surrogate's map, which leaves chi2 %.4g (trusted up to"
                " %g).", chi2, most_chi2,
            )  # fmt: skip
            return settings
        _log.info("The prior is about the surrogate's map")
        return replace(
            settings, regularization=ShiftedPrior(prior=prior, mean_mpa=found, share=share)
        )


def answer(
    network: Surrogate, seen: Touch
) -> tuple[Float[np.ndarray, "w w w"], Float[np.ndarray, "w w w"]]:
    """Return mean and deviation of log E over the uniform modulus, on the grid."""
    presses = torch.from_numpy(seen.presses).float()[None]
    there = torch.ones((1, len(seen.presses)), dtype=torch.bool)
    with torch.inference_mode():
        mean, deviation = network(presses, there, torch.from_numpy(seen.shared).float()[None])
    return mean[0].double().numpy(), deviation[0].double().numpy()

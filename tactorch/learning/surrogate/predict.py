"""A trained surrogate at work: it foretells the map of a recording, to start an inversion from."""

import logging
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
import torch
from jaxtyping import Float

from tactorch.config import Options, option
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


@dataclass(frozen=True, eq=False)
class SurrogateStart(Options):
    """From the map that a network predicts; refused where a uniform one fits better.

    Give it to `invert` as `start_mpa`. Where the predicted map fits the presses no better than the
    best uniform map, the latter is the start.

    Attributes:
        weights: Checkpoint of `tactorch train experiment=surrogate`; None for the weights that
            tactorch includes. They are read when first needed.
        prior_mean: Whether the predicted map is the mean of the prior too: "auto" where it explains
            the presses but for some noise.
        prior_share: Share of the prior that has this mean.
    """

    section: ClassVar[str] = "initialization"
    __name__: ClassVar[str] = "surrogate"
    weights: Path | None = option(
        None, "Checkpoint of tactorch train experiment=surrogate; null: the included one"
    )
    prior_mean: bool | Literal["auto"] = option(
        "auto",
        "Use the map as the mean of the prior too; auto: where it explains the presses",
    )
    prior_share: float = option(
        HALF, "Share of the prior with this mean; at 0.5 the data decide", gt=0, le=1
    )

    def fresh(self) -> "SurrogateStart":
        """Return a start with the same network and no stored prediction."""
        other = replace(self)
        vars(other)["network"] = self.network
        return other

    @cached_property
    def network(self) -> Surrogate:
        """The network.

        Raises:
            FileError: The weights are missing, damaged or of another model.
        """
        return load_surrogate(self.weights or SHIPPED)

    def predict(
        self,
        recording: Recording,
        *,
        noise: NoiseModel | None = None,
        bounds: Bounds | None = None,
    ) -> Prediction:
        """Foretell the map; the truth is not read, and the map's own misfit not looked at.

        Args:
            recording: Presses on an object.
            noise: Standard deviations for presses that do not state theirs.
            bounds: Limits of the moduli.

        Raises:
            ConvergenceError: No uniform modulus carries the presses.
            FileError: The weights are missing, damaged or of another model.
        """
        key, last = (noise, bounds), self._last
        if last and last[0] is recording and last[1] == key:
            prediction: Prediction = last[2]
            return prediction
        cells = self.network.cells
        seen = touch(recording, cells, self.network.frames, noise=noise, bounds=bounds)
        mean, deviation = answer(self.network, seen)
        grid, limits = VoxelGrid(recording.mesh, 2 * cells), bounds or Bounds()
        youngs = seen.youngs_mpa * np.exp(grid.at_elements(mean))
        prediction = Prediction(
            np.clip(youngs, limits.lower, limits.upper),
            np.exp(grid.at_elements(np.log(deviation))),
        )
        self._last[:] = [recording, key, prediction]
        return prediction

    @cached_property
    def _last(self) -> list[Any]:
        """Recording, noise with bounds, and prediction of the last call."""
        return []

    def __call__(self, problem: InverseProblem, bounds: Bounds) -> Float[np.ndarray, " m"]:
        """Return the foretold map, or the best uniform one if that fits better.

        Raises:
            ConvergenceError: No uniform modulus carries the presses.
            FileError: The weights are missing, damaged or of another model.
        """
        found = self.predict(problem.recording, noise=problem.noise, bounds=bounds).youngs
        taken = fits_better_than_uniform(found, problem, bounds, "surrogate's")
        return found if taken else homogeneous(problem, bounds)

    def with_prior_mean(self, settings: Settings, recording: Recording) -> Settings:
        """Return settings whose prior has the predicted map as its mean, where that is wanted.

        Regions that the presses do not determine then keep the prediction. On objects unlike the
        training data that would mislead; maps of such objects do not fit the presses, and then, as
        where the map is refused as a start, the settings are returned unchanged. With a share of
        0.5 the data still decide: total variation takes any map between a constant and the
        prediction as equally likely.

        Args:
            settings: Settings of the inversion.
            recording: Presses on an object.

        Returns:
            The settings, with a `ShiftedPrior` where `prior_mean` is set and the map explains the
            presses: any map that is not refused with True, maps with chi2 up to `TRUSTED` with
            "auto".

        Raises:
            ConfigError: the prior has no mean, or refers to levels.
            ConvergenceError: no uniform modulus carries the presses.
            FileError: the weights are missing, damaged or of another model.
        """
        if self.prior_mean is False:
            return settings
        max_chi2 = TRUSTED if self.prior_mean == "auto" else float("inf")
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
        if chi2 > max_chi2:
            _log.info(
                "The prior is not about the surrogate's map, which leaves chi2 %.4g (trusted up to"
                " %g).", chi2, max_chi2,
            )  # fmt: skip
            return settings
        _log.info("The prior is about the surrogate's map")
        return replace(
            settings,
            regularization=ShiftedPrior(prior=prior, mean_mpa=found, share=self.prior_share),
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

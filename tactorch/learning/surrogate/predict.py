"""Initialization of an inversion by the map that a trained surrogate predicts."""

import logging
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import ClassVar, Literal, NamedTuple

import numpy as np
import torch
from jaxtyping import Float

from tactorch.config import Options, option
from tactorch.errors import ConfigError, ConvergenceError
from tactorch.inverse import (
    BinaryWell,
    Bounds,
    InverseProblem,
    NoiseModel,
    NoPrior,
    Settings,
    ShiftedPrior,
    homogeneous,
    make_objective,
)
from tactorch.inverse.fit.starts import uniform_fit
from tactorch.learning.surrogate.features import compute_features
from tactorch.learning.surrogate.network import INCLUDED_WEIGHTS, Surrogate, load_surrogate
from tactorch.mesh import VoxelGrid
from tactorch.recording import Recording

_log = logging.getLogger(__name__)
MAX_TRUSTED_CHI2 = 10.0  # of maps that explain the presses up to the noise


class Prediction(NamedTuple):
    """Map predicted by a surrogate.

    Attributes:
        youngs: Predicted Young's modulus of each element, (m,), MPa.
        deviation: Standard deviation of the log-modulus, (m,).
    """

    youngs: Float[np.ndarray, " m"]
    deviation: Float[np.ndarray, " m"]


@dataclass(frozen=True, eq=False)
class SurrogateStart(Options):
    """Start from the map that a network predicts, unless a uniform map fits better.

    The value of `start_mpa` of `invert`. If the predicted map fits the presses no better than the
    best uniform map, the latter is the start. The weights are read when first needed.
    """

    section: ClassVar[str] = "initialization"
    __name__: ClassVar[str] = "surrogate"
    weights: Path | None = option(
        None, "Checkpoint of tactorch train experiment=surrogate; null: the included one"
    )
    prior_mean: bool | Literal["auto"] = option(
        "auto", "Use the map also as the mean of the prior; auto: if it explains the presses"
    )
    prior_share: float = option(
        0.5, "Share of the prior with this mean; at 0.5 the data decide", gt=0, le=1
    )

    @cached_property
    def network(self) -> Surrogate:
        """Trained network; `FileError` if the weights are missing or damaged."""
        return load_surrogate(self.weights or INCLUDED_WEIGHTS)

    def predict(
        self, recording: Recording, *, noise: NoiseModel | None = None, bounds: Bounds | None = None
    ) -> Prediction:
        """Return the predicted map of a recording; the truth is not used.

        Args:
            recording: Presses on an object.
            noise: Standard deviations for presses that do not state theirs.
            bounds: Limits of the moduli.

        Raises:
            ConvergenceError: The presses have an equilibrium with no uniform modulus.
            FileError: The weights are missing, damaged or of another model.
        """
        return _predict(self.network, recording, noise, bounds)

    def __call__(self, problem: InverseProblem, bounds: Bounds) -> Float[np.ndarray, " m"]:
        """Return the predicted map, or the best uniform one if that fits better, MPa."""
        predicted = self.predict(problem.recording, noise=problem.noise, bounds=bounds).youngs
        if fits_better_than_uniform(predicted, problem, bounds):
            return predicted
        return homogeneous(problem, bounds)

    def with_prior_mean(self, settings: Settings, recording: Recording) -> Settings:
        """Return settings whose prior has the predicted map as its mean.

        Regions that the presses do not determine then keep the prediction. The settings are
        returned unchanged if the map is rejected as a start or does not explain the presses, as
        for objects unlike the training data. With a share of 0.5, total variation gives the same
        probability to all maps between a constant and the prediction.

        Returns:
            The settings, with a `ShiftedPrior` if the map is accepted: any map that fits better
            than a uniform one with `prior_mean=True`, maps of chi2 up to `MAX_TRUSTED_CHI2` with
            "auto".

        Raises:
            ConfigError: The prior has no mean, or refers to levels.
            ConvergenceError: The presses have an equilibrium with no uniform modulus.
            FileError: The weights are missing, damaged or of another model.
        """
        if self.prior_mean is False:
            return settings
        max_chi2 = MAX_TRUSTED_CHI2 if self.prior_mean == "auto" else float("inf")
        prior, bounds = settings.regularization, settings.bounds
        has_level = any(getattr(prior, name, None) for name in ("level_mpa", "region_mpa"))
        if isinstance(prior, NoPrior | BinaryWell) or has_level:
            raise ConfigError(
                f"a surrogate's map cannot be the mean of {prior}; choose another prior, such as "
                "total_variation, without a level."
            )
        problem = make_objective(recording, settings).problem
        predicted = self.predict(recording, noise=settings.noise, bounds=bounds).youngs
        if not fits_better_than_uniform(predicted, problem, bounds):
            return settings
        chi2 = problem.evaluate(predicted).chi2
        if chi2 > max_chi2:
            _log.info(
                "The surrogate's map is not used as the mean of the prior: its chi2 is %.4g (limit"
                " %g).", chi2, max_chi2,
            )  # fmt: skip
            return settings
        _log.info("The surrogate's map is the mean of the prior")
        shifted = ShiftedPrior(prior=prior, mean_mpa=predicted, share=self.prior_share)
        return replace(settings, regularization=shifted)


@lru_cache(maxsize=1)  # an inversion needs the same prediction for its start and for its prior
def _predict(
    network: Surrogate, recording: Recording, noise: NoiseModel | None, bounds: Bounds | None
) -> Prediction:
    cells, frames = network.cells, network.frames
    features = compute_features(recording, cells, frames, noise=noise, bounds=bounds)
    presses = torch.from_numpy(features.presses).float()[None]
    shared = torch.from_numpy(features.shared).float()[None]
    with torch.inference_mode():
        fields = network(presses, torch.ones(presses.shape[:2], dtype=torch.bool), shared)
    mean, deviation = (field[0].double().numpy() for field in fields)
    grid, limits = VoxelGrid(recording.mesh, 2 * cells), bounds or Bounds()
    youngs = features.youngs_mpa * np.exp(grid.at_elements(mean))
    spread = np.exp(grid.at_elements(np.log(deviation)))
    return Prediction(np.clip(youngs, limits.lower, limits.upper), spread)


def fits_better_than_uniform(
    guess: Float[np.ndarray, " m"], problem: InverseProblem, bounds: Bounds
) -> bool:
    """Return whether a guessed map (MPa) fits the presses better than the best uniform one.

    Both are compared at the nuisance values that the recording states, from which inversions start.
    """
    try:
        chi2 = problem.evaluate(guess).chi2
    except ConvergenceError as error:
        _log.warning("The surrogate's map is refused: the presses collapse it (%s).", error)
        return False
    fit = uniform_fit(problem, bounds, first_mpa=float(np.median(guess)))
    known = problem.evaluate(np.full(problem.n_elements, fit.youngs_mpa)).chi2
    if not chi2 < known:
        _log.warning(
            "The surrogate's map is refused: its misfit (chi2 %.4g) is no less than that of the "
            "best uniform map (%.4g).", chi2, known,
        )  # fmt: skip
        return False
    _log.info("The surrogate's map is taken: chi2 %.4g, best uniform map %.4g", chi2, known)
    return True

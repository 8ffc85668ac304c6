"""How far a map is to be believed, element by element and press by press."""

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from tactorch.errors import TactorchError
from tactorch.findings import Confidence, confidence_of, find_lump
from tactorch.inverse import NoiseModel, Point, Settings, settings_from, solution
from tactorch.inverse.nuisance.press_model import PressModelFactory
from tactorch.inverse.nuisance.values import Nuisance
from tactorch.recording import Recording
from tactorch.report.runs import Run
from tactorch.uncertainty import credibility
from tactorch.uncertainty.select import UNCOMPUTABLE, posterior_at

LEVEL = 0.95
#: Called with what is about to be done, and how many such steps are done of how many.
ProgressCallback = Callable[[str, int, int], None]

_STEPS = 4
_AT_BOUND = 0.01  # share of a bound within which a modulus lies at it
_log = logging.getLogger("tactorch")


@dataclass(frozen=True, eq=False)
class UncertaintySummary:
    """What is known of each element's modulus.

    Attributes:
        credibility: L of the paper's eq. (15), mm/MPa, (m,).
        low: Lower end of the interval of 95 %, MPa, (m,).
        high: Its upper end, MPa, (m,).
        resolution: Share of the data in each modulus: near 1 they decide, near 0 the prior, (m,).
        at_bound: Where the map lies at a bound of the moduli, which cuts the interval off, (m,).
        kind: Class of the posterior.
        sure: Of what stands out of the map; None where nothing does.
    """

    credibility: Float[np.ndarray, " m"]
    low: Float[np.ndarray, " m"]
    high: Float[np.ndarray, " m"]
    resolution: Float[np.ndarray, " m"]
    at_bound: Bool[np.ndarray, " m"]
    kind: str
    sure: Confidence | None = None

    @property
    def spread(self) -> Float[np.ndarray, " m"]:
        """Half the interval, as a share of the modulus: 0.3 is up or down by a factor of 1.3.

        NaN at a bound, where there is no such interval.
        """
        return np.where(self.at_bound, np.nan, np.sqrt(self.high / self.low) - 1.0)


@dataclass(frozen=True, eq=False)
class Fit:
    """How well one press is foretold.

    Attributes:
        residual: Predicted less observed, mm, (n, 3); NaN where nothing was observed.
        deviations: It in independent standard deviations, as the inversion weighs it, (n, 3).
    """

    residual: Float[np.ndarray, "n 3"]
    deviations: Float[np.ndarray, "n 3"]

    @property
    def rms_mm(self) -> float:
        """Root mean square of the residual, mm."""
        return float(np.sqrt(np.nanmean(self.residual**2)))

    @property
    def rms_deviations(self) -> float:
        """Root mean square of the residual in standard deviations."""
        return float(np.sqrt(np.nanmean(self.deviations**2)))


@dataclass(frozen=True, eq=False)
class Judgement:
    """What can be told of a run.

    Attributes:
        belief: Of each element; None where it was left out or could not be had.
        fits: Of each press; empty without a recording.
        missing: Why something is missing; empty where nothing is.
        corrected: Whether the mesh's own error is taken off the residuals, as the inversion did;
            None where that takes no correction off.
    """

    belief: UncertaintySummary | None
    fits: list[Fit]
    missing: str
    corrected: bool | None


def judge(run: Run, *, uncertainty: bool = True, tell: ProgressCallback | None = None) -> Judgement:
    """Tell how far to believe a run's map and how well its presses are foretold.

    Args:
        run: The run.
        uncertainty: Whether to solve its presses again, for credibility and posterior: some ten
            seconds for two thousand elements, minutes for ten thousand.
        tell: Called before each step.
    """
    if run.recording is None:
        return Judgement(None, [], run.missing, False)
    if not uncertainty:
        return Judgement(None, _plain_fits(run, run.recording), "it was left out", False)
    try:
        return _believed(run, run.recording, tell or (lambda *_: None))
    except UNCOMPUTABLE as error:
        reason = str(error) or "the memory does not suffice"
        _log.warning("%s: no uncertainty: %s", run.name, reason)
        return Judgement(None, _plain_fits(run, run.recording), reason, False)


def _believed(run: Run, recording: Recording, tell: ProgressCallback) -> Judgement:
    tell("presses at the map", 0, _STEPS)
    point = solution(recording, run.found, run.settings or settings_from(run.found.config))
    tell("credibility", 1, _STEPS)
    felt = credibility(point.evaluation).values
    tell("posterior", 2, _STEPS)
    posterior = posterior_at(point, run.found.history[-1].get("weight", 0.0))
    tell("intervals", 3, _STEPS)
    low, high = posterior.interval(LEVEL)
    resolution = np.clip(posterior.resolution_diagonal(), 0.0, 1.0)
    tell("done", _STEPS, _STEPS)
    bounds = posterior.parameterization.bounds
    at_bound = (point.youngs < (1 + _AT_BOUND) * bounds.lower) | (
        point.youngs > (1 - _AT_BOUND) * bounds.upper
    )
    at_bound |= low == high  # all of the interval lies beyond a bound
    lump = find_lump(recording.mesh, run.found.youngs)
    sure = None if lump is None else confidence_of(recording.mesh, lump, posterior)
    belief = UncertaintySummary(
        felt, low, high, resolution, at_bound, type(posterior).__name__, sure
    )
    corrected = None if point.objective.problem.model_deviation is None else True
    return Judgement(belief, _fits(recording, point), "", corrected)


def _fits(recording: Recording, point: Point) -> list[Fit]:
    found, fits = point.evaluation, []
    for seen, reported, deviations in zip(
        point.objective.problem.observations, found.reported, found.deviations, strict=True
    ):
        both = np.full((2, recording.mesh.n_points * 3), np.nan)
        both[0, seen.index] = reported.ravel()[seen.index] - seen.displacement
        both[1, seen.index] = deviations
        fits.append(Fit(*both.reshape(2, -1, 3)))
    return fits


def _plain_fits(run: Run, recording: Recording) -> list[Fit]:
    """Residuals as they are without the corrections that take solving the presses again."""
    placing, values = PressModelFactory(recording), _nuisance_of(run, recording)
    deviations = _noise_of(run).deviations(recording)
    fits = []
    for i, (press, moved) in enumerate(
        zip(recording.presses, run.found.displacements, strict=True)
    ):
        weights = np.ones_like(press.forces) if press.weights is None else press.weights
        counts = press.data & (weights > 0)
        reported = placing.at(values, i).reported(moved)
        residual = np.where(counts, reported - press.displacement, np.nan)
        fits.append(Fit(residual, residual * weights / deviations[i]))
    return fits


def _nuisance_of(run: Run, recording: Recording) -> Nuisance:
    """The values that the run estimated, else those that the recording states."""
    found: dict[str, Any] = {name: estimate.value for name, estimate in run.found.nuisance.items()}
    for name in {"poisson", "force_scale"} & found.keys():
        found[name] = float(found[name][0])
    return replace(Nuisance.assumed(recording), **found)


def _noise_of(run: Run) -> NoiseModel:
    if run.settings is not None:
        return run.settings.noise
    told = run.found.config.get("settings", {}).get("noise", {})
    try:
        return NoiseModel(**told)
    except (TypeError, TactorchError):  # of another version
        return Settings().noise

"""Uncertainty of the map of a run and residuals of its presses."""

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from tactorch.errors import TactorchError
from tactorch.findings import Confidence, compute_confidence, find_lump
from tactorch.inverse import NoiseModel, Nuisance, Point, Settings, settings_from
from tactorch.inverse.invert import solution
from tactorch.inverse.nuisance import PressModel
from tactorch.recording import Recording
from tactorch.report.runs import Run
from tactorch.uncertainty import credibility
from tactorch.uncertainty.select import UNCOMPUTABLE, posterior_at

LEVEL = 0.95
#: Called before each step with its name, the number of finished steps and their total.
ProgressCallback = Callable[[str, int, int], None]

_STEPS = ("presses at the map", "credibility", "posterior", "intervals", "done")
_AT_BOUND = 0.01  # relative distance below which a modulus is at a bound
_log = logging.getLogger("tactorch")


@dataclass(frozen=True, eq=False)
class UncertaintySummary:
    """Uncertainty of the modulus of each element.

    Attributes:
        credibility: L of eq. (15) of the paper, mm/MPa (m,).
        low: Lower end of the 95 % interval, MPa (m,).
        high: Upper end of the 95 % interval, MPa (m,).
        resolution: Diagonal of the resolution matrix (m,): 1 if the data determine the modulus, 0
            if the prior does.
        at_bound: Elements at a bound of the moduli, which truncates the interval (m,).
        kind: Class of the posterior.
        confidence: Confidence of the most conspicuous inclusion; None if there is none.
    """

    credibility: Float[np.ndarray, " m"]
    low: Float[np.ndarray, " m"]
    high: Float[np.ndarray, " m"]
    resolution: Float[np.ndarray, " m"]
    at_bound: Bool[np.ndarray, " m"]
    kind: str
    confidence: Confidence | None = None

    @property
    def relative_half_width(self) -> Float[np.ndarray, " m"]:
        """Relative half width of the interval (m,): 0.3 is a factor of 1.3; NaN at a bound."""
        return np.where(self.at_bound, np.nan, np.sqrt(self.high / self.low) - 1.0)


@dataclass(frozen=True, eq=False)
class PressFit:
    """Residual of one press.

    Attributes:
        residual: Predicted less observed displacement, mm (n, 3); NaN if not observed.
        deviations: Residual in standard deviations, weighted as in the inversion (n, 3).
    """

    residual: Float[np.ndarray, "n 3"]
    deviations: Float[np.ndarray, "n 3"]

    @property
    def rms_mm(self) -> float:
        """Root mean square residual, mm."""
        return float(np.sqrt(np.nanmean(self.residual**2)))

    @property
    def rms_deviations(self) -> float:
        """Root mean square residual, standard deviations."""
        return float(np.sqrt(np.nanmean(self.deviations**2)))


@dataclass(frozen=True, eq=False)
class Assessment:
    """Uncertainty of a map and residuals of its presses.

    Attributes:
        uncertainty: Uncertainty of the map; None if it was not computed.
        fits: Residual of each press; empty without a recording.
        missing: Reason why something is missing; empty if nothing is.
        corrected: Whether the discretisation error is removed from the residuals; None if the
            inversion does not correct it.
    """

    uncertainty: UncertaintySummary | None
    fits: list[PressFit]
    missing: str
    corrected: bool | None


def assess(
    run: Run, *, uncertainty: bool = True, progress: ProgressCallback | None = None
) -> Assessment:
    """Compute the uncertainty of the map of a run and the residuals of its presses.

    Args:
        run: The run.
        uncertainty: Whether the presses are solved again for credibility and posterior, which
            takes about 10 s for 2,000 elements and minutes for 10,000.
        progress: Called before each step.

    Returns:
        The assessment; a posterior that cannot be computed is logged and omitted.
    """
    if run.recording is None:
        return Assessment(None, [], run.missing, False)
    reason = "switched off"
    if uncertainty:
        try:
            return _assess_uncertainty(run, run.recording, progress or (lambda *_: None))
        except UNCOMPUTABLE as error:
            reason = str(error) or "not enough memory"
            _log.warning("%s: no uncertainty: %s", run.name, reason)
    return Assessment(None, _uncorrected_fits(run, run.recording), reason, False)


def _assess_uncertainty(run: Run, recording: Recording, progress: ProgressCallback) -> Assessment:
    def step(number: int) -> None:
        progress(_STEPS[number], number, len(_STEPS) - 1)

    step(0)
    point = solution(recording, run.result, run.settings or settings_from(run.result.config))
    step(1)
    metric = credibility(point.evaluation).values
    step(2)
    posterior = posterior_at(point, run.result.history[-1].get("weight", 0.0))
    step(3)
    low, high = posterior.interval(LEVEL)
    resolution = np.clip(posterior.resolution_diagonal(), 0.0, 1.0)
    step(4)
    bounds = posterior.parameterization.bounds
    at_bound = (point.youngs < (1 + _AT_BOUND) * bounds.lower) | (
        point.youngs > (1 - _AT_BOUND) * bounds.upper
    )
    at_bound |= low == high  # the whole interval is beyond a bound
    inclusion = find_lump(recording.mesh, run.result.youngs)
    confidence = (
        None if inclusion is None else compute_confidence(recording.mesh, inclusion, posterior)
    )
    summary = UncertaintySummary(
        metric, low, high, resolution, at_bound, type(posterior).__name__, confidence
    )
    corrected = None if point.objective.problem.data.model_deviation is None else True
    return Assessment(summary, _corrected_fits(recording, point), "", corrected)


def _corrected_fits(recording: Recording, point: Point) -> list[PressFit]:
    evaluation, fits = point.evaluation, []
    for observation, reported, deviations in zip(
        point.objective.problem.data.observations,
        evaluation.reported,
        evaluation.deviations,
        strict=True,
    ):
        index = observation.index
        values = np.full((2, recording.mesh.n_points * 3), np.nan)
        values[0, index] = reported.ravel()[index] - observation.displacement
        values[1, index] = deviations
        fits.append(PressFit(*values.reshape(2, -1, 3)))
    return fits


def _uncorrected_fits(run: Run, recording: Recording) -> list[PressFit]:
    """Return residuals without the corrections that require solving the presses again."""
    values = _nuisance(run, recording)
    deviations = _noise_model(run).deviations(recording)
    fits = []
    for i, (press, displacement) in enumerate(
        zip(recording.presses, run.result.displacements, strict=True)
    ):
        weights = np.ones_like(press.forces) if press.weights is None else press.weights
        used = press.data & (weights > 0)
        reported = PressModel.of(press, recording.mesh, values).reported(displacement)
        residual = np.where(used, reported - press.displacement, np.nan)
        fits.append(PressFit(residual, residual * weights / deviations[i]))
    return fits


def _nuisance(run: Run, recording: Recording) -> Nuisance:
    """Return the estimates of the run, or the values of the recording."""
    values: dict[str, Any] = {name: one.value for name, one in run.result.nuisance.items()}
    for name in {"poisson", "force_scale"} & values.keys():
        values[name] = float(values[name][0])
    return replace(Nuisance.assumed(recording), **values)


def _noise_model(run: Run) -> NoiseModel:
    if run.settings is not None:
        return run.settings.noise
    stored = run.result.config.get("settings", {}).get("noise", {})
    try:
        return NoiseModel(**stored)
    except (TypeError, TactorchError):  # of another version
        return Settings().noise

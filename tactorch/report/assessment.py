"""Computation of the uncertainty of a run's result and the residuals of its presses."""

import logging
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from tactorch.errors import UNCOMPUTABLE
from tactorch.inverse import settings_from
from tactorch.inverse.data.observations import Observation
from tactorch.inverse.forward.gel import is_of_grasps
from tactorch.inverse.forward.palpation import is_palpation
from tactorch.inverse.forward.predictions import observed_data
from tactorch.inverse.invert import solution
from tactorch.inverse.posterior import GaussianPosterior, credibility, posterior_at
from tactorch.inverse.result import LEVEL
from tactorch.recording import Recording
from tactorch.report.content import PressFit, RunReport, UncertaintySummary
from tactorch.report.runs import Run

#: Called before each step with its name, the number of finished steps and their total.
ProgressCallback = Callable[[str, int, int], None]

_STEPS = ("presses at the result", "credibility", "posterior", "intervals", "done")
_NO_DISPLACEMENTS = "a palpation has no observed displacements"
_AT_BOUND = 0.01  # relative distance below which a modulus is at a bound
_log = logging.getLogger("tactorch")


def assess(
    run: Run, *, uncertainty: bool = True, progress: ProgressCallback | None = None
) -> RunReport:
    """Compute the uncertainty of the result of a run and the residuals of its presses.

    With `uncertainty` the presses are solved again for the credibility and the posterior of an
    element map, which takes about 10 s for 2,000 elements and minutes for 10,000; inclusions have
    their posterior already. What cannot be computed is logged and omitted. `progress` is called
    before each step.
    """
    if run.recording is None:
        return RunReport(run, _known(run), missing=run.missing)
    fits, reason = _fits(run, run.recording), "switched off"
    if not is_solved_again(run):
        reason = _NO_DISPLACEMENTS
    elif uncertainty:
        try:
            report = _assess(run, run.recording, progress or (lambda *_: None))
            return replace(report, fits=fits)
        except UNCOMPUTABLE as error:
            reason = str(error) or "not enough memory"
            _log.warning("%s: no uncertainty: %s", run.name, reason)
    return RunReport(run, _known(run), fits=fits, missing=reason)


def is_solved_again(run: Run) -> bool:
    """Return whether the presses of a run are solved again for its uncertainty.

    Inclusions have their posterior; palpations and grasps have no displacements, nor their
    credibility.
    """
    recording = run.recording
    if recording is None or run.result.shapes is None:
        return recording is not None
    return not (is_palpation(recording) or is_of_grasps(recording))


def _known(run: Run) -> UncertaintySummary | None:
    """Return the intervals of a result that has them."""
    intervals = run.result.intervals()
    return None if intervals is None else UncertaintySummary(*intervals)


def _assess(run: Run, recording: Recording, progress: ProgressCallback) -> RunReport:
    def step(number: int) -> None:
        progress(_STEPS[number], number, len(_STEPS) - 1)

    step(0)
    result = run.result
    point = solution(recording, result, run.settings or settings_from(result.config))
    step(1)
    metric = None if is_palpation(recording) else credibility(point.evaluation)
    step(2)
    if result.shapes is not None:
        known = _known(run)
        assert known is not None
    else:
        posterior = posterior_at(point, result.weight)
        step(3)
        known = _of_elements(posterior, point.youngs)
        run = replace(run, result=result.with_posterior(recording, posterior))
    step(4)
    missing = _NO_DISPLACEMENTS if metric is None else ""
    return RunReport(run, replace(known, credibility=metric), missing=missing)


def _of_elements(
    posterior: GaussianPosterior, youngs: Float[np.ndarray, " m"]
) -> UncertaintySummary:
    """Return the intervals of an element map."""
    low, high = posterior.interval(LEVEL)
    bounds = posterior.parameterization.bounds
    at_bound = youngs < (1 + _AT_BOUND) * bounds.lower
    at_bound |= youngs > (1 - _AT_BOUND) * bounds.upper
    at_bound |= low == high  # the whole interval is beyond a bound
    resolution = np.clip(posterior.resolution_diagonal(), 0.0, 1.0)
    return UncertaintySummary(low, high, resolution, None, at_bound, type(posterior).__name__)


def _fits(run: Run, recording: Recording) -> list[PressFit]:
    """Return the residuals of each press; NaN where the result does not have them."""
    count = len(observed_data(recording.presses))
    predicted = _of_length(run.result.predicted, count)
    residuals = _of_length(run.result.residuals, count)
    fits, begin = [], 0
    noise = run.noise.deviations(recording)
    for i, (press, deviation) in enumerate(zip(recording.presses, noise, strict=True)):
        observation = Observation.of(press, deviation)
        rows = slice(begin, begin + len(observation.values))
        begin, index = rows.stop, observation.index
        difference, scaled = predicted[rows] - observation.values, residuals[rows]
        if np.isnan(scaled).all():  # of an earlier version
            if i < len(run.result.displacements):
                moved = run.result.displacements[i].ravel()[index]
                difference[observation.nodal] = moved - observation.values[observation.nodal]
            scaled = difference * observation.scale
        values = np.full((2, recording.mesh.n_points * 3), np.nan)
        values[:, index] = difference[observation.nodal], scaled[observation.nodal]
        residual, deviations = values.reshape(2, -1, 3)
        fits.append(PressFit(residual, deviations, scaled[len(index) :]))
    return fits


def _of_length(values: np.ndarray | None, count: int) -> np.ndarray:
    return values if values is not None and len(values) == count else np.full(count, np.nan)

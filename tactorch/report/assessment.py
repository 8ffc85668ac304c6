"""Computation of the uncertainty of a run's map and the residuals of its presses."""

import logging
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from tactorch.findings import Finding, build_finding, build_shape_finding, find_lump
from tactorch.findings.finding import build_lump
from tactorch.inverse import Nuisance, Point, settings_from
from tactorch.inverse.data import Observation
from tactorch.inverse.invert import solution
from tactorch.inverse.nuisance import PressModel
from tactorch.recording import Recording
from tactorch.report.content import PressFit, RunReport, UncertaintySummary
from tactorch.report.runs import Run
from tactorch.uncertainty import GaussianPosterior, credibility
from tactorch.uncertainty.select import UNCOMPUTABLE, posterior_at

LEVEL = 0.95
#: Called before each step with its name, the number of finished steps and their total.
ProgressCallback = Callable[[str, int, int], None]

_STEPS = ("presses at the map", "credibility", "posterior", "intervals", "done")
_AT_BOUND = 0.01  # relative distance below which a modulus is at a bound
_log = logging.getLogger("tactorch")


def assess(
    run: Run, *, uncertainty: bool = True, progress: ProgressCallback | None = None
) -> RunReport:
    """Compute the uncertainty of the map of a run and the residuals of its presses.

    With `uncertainty` the presses are solved again for credibility and posterior, which takes about
    10 s for 2,000 elements and minutes for 10,000. A posterior that cannot be computed is logged
    and omitted. `progress` is called before each step.
    """
    if run.recording is None:
        return RunReport(run, _find(run), missing=run.missing)
    reason = "switched off"
    if uncertainty:
        try:
            return _assess_uncertainty(run, run.recording, progress or (lambda *_: None))
        except UNCOMPUTABLE as error:
            reason = str(error) or "not enough memory"
            _log.warning("%s: no uncertainty: %s", run.name, reason)
    fits = _uncorrected_fits(run, run.recording)
    return RunReport(run, _find(run), fits=fits, missing=reason)


def _find(run: Run, posterior: GaussianPosterior | None = None) -> Finding:
    """Return the lumps of the shapes that were fitted to the presses, else those of the map."""
    mesh, youngs = run.result.mesh, run.result.youngs
    if run.recording is None:
        inclusion = find_lump(mesh, youngs)
        lumps = () if inclusion is None else (build_lump(mesh, (), inclusion, None),)
        return Finding(mesh, lumps, float(np.median(youngs)), run.result.warnings)
    if run.shapes is not None:
        return build_shape_finding(run.recording, run.shapes)
    reasons = run.result.warnings
    return build_finding(run.recording, youngs, posterior, max_lumps=1, reasons=reasons)


def _assess_uncertainty(run: Run, recording: Recording, progress: ProgressCallback) -> RunReport:
    def step(number: int) -> None:
        progress(_STEPS[number], number, len(_STEPS) - 1)

    step(0)
    point = solution(recording, run.result, run.settings or settings_from(run.result.config))
    step(1)
    metric = credibility(point.evaluation)
    step(2)
    posterior = posterior_at(point, run.result.history[-1].get("weight", 0.0))
    step(3)
    low, high = posterior.interval(LEVEL)
    resolution = np.clip(posterior.resolution_diagonal(), 0.0, 1.0)
    step(4)
    bounds, youngs = posterior.parameterization.bounds, point.youngs
    at_bound = youngs < (1 + _AT_BOUND) * bounds.lower
    at_bound |= youngs > (1 - _AT_BOUND) * bounds.upper
    at_bound |= low == high  # the whole interval is beyond a bound
    summary = UncertaintySummary(metric, low, high, resolution, at_bound, type(posterior).__name__)
    corrected = None if point.objective.problem.data.model_deviation is None else True
    fits = _corrected_fits(recording, point)
    return RunReport(run, _find(run, posterior), summary, fits, corrected=corrected)


def _corrected_fits(recording: Recording, point: Point) -> list[PressFit]:
    evaluation, fits = point.evaluation, []
    observations = point.objective.problem.data.observations
    for observation, reported, deviations in zip(
        observations, evaluation.reported, evaluation.deviations, strict=True
    ):
        index = observation.index
        values = np.full((2, recording.mesh.n_points * 3), np.nan)
        values[0, index] = reported.ravel()[index] - observation.values[observation.nodal]
        values[1, index] = deviations[observation.nodal]
        others = deviations[len(index) :]
        residual, scaled = values.reshape(2, -1, 3)
        fits.append(PressFit(residual, scaled, others))
    return fits


def _uncorrected_fits(run: Run, recording: Recording) -> list[PressFit]:
    """Return residuals without the corrections that require solving the presses again."""
    values, predicted = _nuisance(run, recording), _predicted(run, recording)
    deviations = run.noise.deviations(recording)
    unknown = np.broadcast_to(np.nan, recording.mesh.points.shape)
    fits = []
    for i, press in enumerate(recording.presses):
        observation = Observation.of(press, deviations[i])
        others = (predicted[i] - observation.values)[len(observation.index) :]
        others = others * observation.scale[len(observation.index) :]
        if not len(run.result.displacements):
            fits.append(PressFit(unknown, unknown, others))
            continue
        weights = np.ones_like(press.forces) if press.weights is None else press.weights
        used = press.data & (weights > 0)
        model = PressModel.of(press, recording.mesh, values)
        reported = model.reported(run.result.displacements[i])
        residual = np.where(used, reported - press.displacement, np.nan)
        fits.append(PressFit(residual, residual * weights / deviations[i], others))
    return fits


def _predicted(run: Run, recording: Recording) -> list[np.ndarray]:
    """Return the predictions of the data of each press, NaN where the result does not have them."""
    counts = [len(Observation.of(press, 1.0).values) for press in recording.presses]
    predicted = run.result.predicted
    if predicted is None or len(predicted) != sum(counts):
        predicted = np.full(sum(counts), np.nan)
    return np.split(predicted, np.cumsum(counts)[:-1])


def _nuisance(run: Run, recording: Recording) -> Nuisance:
    """Return the estimates of the run, or the values of the recording."""
    values: dict[str, Any] = {k: estimate.value for k, estimate in run.result.nuisance.items()}
    for name in {"poisson", "force_scale"} & values.keys():
        values[name] = float(values[name][0])
    return replace(Nuisance(recording.material.poisson), **values)

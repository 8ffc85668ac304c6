"""From a recording to the field of Young's modulus, in one call."""

import logging
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from tactorch.config import to_mapping
from tactorch.errors import UNCOMPUTABLE, CancelledError, ConfigError
from tactorch.fem import SoftBody
from tactorch.inverse.data.misfit import MISFITS, Adaptive, Squares
from tactorch.inverse.data.observations import NoiseModel
from tactorch.inverse.errors import ERRORS, ErrorModel, MeasuredPresses
from tactorch.inverse.errors.discretisation import (
    RESIDUAL_MODEL_ERROR,
    ModelError,
    corrected,
    discretisation_error,
    resolve_model_error,
)
from tactorch.inverse.fields import ElementField
from tactorch.inverse.fit.monitor import Monitor, StopReason
from tactorch.inverse.fit.objective import Objective, Point
from tactorch.inverse.fit.optimizers.base import OPTIMIZERS
from tactorch.inverse.fit.optimizers.gauss_newton import GaussNewton
from tactorch.inverse.fit.settings import Settings
from tactorch.inverse.fit.starts import START_MPA, Start, checked_start, start_map, uniform_fit
from tactorch.inverse.forward.gel import is_of_grasps
from tactorch.inverse.forward.palpation import (
    PALPATION_ELEMENT,
    PalpationProblem,
    contacts_of,
    is_palpation,
)
from tactorch.inverse.forward.problem import InverseProblem, make_body
from tactorch.inverse.posterior.gaussian import GaussianPosterior
from tactorch.inverse.posterior.laplace import LaplacePosterior
from tactorch.inverse.posterior.select import posterior_at
from tactorch.inverse.result.build import config_of, of_elements, of_inclusions
from tactorch.inverse.result.reconstruction import Reconstruction
from tactorch.inverse.search.criticism import force_errors
from tactorch.inverse.search.held_out import held_out_score
from tactorch.inverse.search.model import MIN_GAIN
from tactorch.inverse.search.search import find_shapes
from tactorch.progress import progress_line
from tactorch.recording import Recording

_log = logging.getLogger(__name__)
_T = TypeVar("_T")
_ADAPT_ITERATIONS = 30
_MIN_REPORTED = 2.0  # factor of the noise of a press that is logged
# Mean squared residual of inclusions, over that of the noise, above which an element map is
# computed too: the model's error is then as large as the noise.
_MAX_CHI2 = 2.0
#: Elements up to which inclusions are searched for, with quadratic elements of eight times the
#: unknowns.
MAX_ELEMENTS = 20_000


def invert(
    recording: Recording,
    settings: Settings | None = None,
    *,
    start_mpa: Start = START_MPA,
    checkpoint: str | Path | None = None,
    resume: str | Path | None = None,
    show_progress: bool | None = None,
    on_iteration: Callable[[dict[str, Any], np.ndarray], None] | None = None,
    **search: Any,
) -> Reconstruction:
    """Reconstruct the field of Young's modulus in the description that the presses support.

    The field is described by inclusions with sharp boundaries in a background (`find_shapes`), or
    by one modulus per element, an element map (`invert_map`, eq. 8). With `settings.method` "auto"
    the element map is computed only where inclusions do not explain the presses or cannot be fitted
    to them. Where both are computed, the one is returned that predicts the presses of a contact
    better from those of the others (`tactorch.inverse.search.held_out`), the inclusions where both
    predict them equally; the other one is the result's `other`.

    The truth and the reference that a recording may carry are never read.

    Args:
        recording: Presses on an object.
        settings: How to invert.
        start_mpa: Start of an element map, see `invert_map`.
        checkpoint: File to save the state of an element map to.
        resume: Checkpoint of an element map to continue from.
        show_progress: Whether to show a line of progress; see `tactorch.progress.progress_line`.
        on_iteration: See `invert_map`.
        search: Arguments of `find_shapes`: `max_shapes`, `start`, `stop`, `kept`.

    Returns:
        The field with its lumps, predictions and reasons not to trust it.

    Raises:
        CancelledError: `stop` returned True.
        ConfigError: a setting cannot be used.
        ConvergenceError: no description has an equilibrium under the recorded forces; with the
            method "inclusions", as of `find_shapes`.
        FileError: the checkpoint to resume cannot be read.
    """
    settings = settings or Settings()
    if settings.method != "inclusions" and not callable(start_mpa):
        checked_start(start_mpa, recording.mesh.n_tets, settings.bounds)

    def element_map() -> Reconstruction:
        result = invert_map(
            recording, settings, start_mpa=start_mpa, checkpoint=checkpoint, resume=resume,
            show_progress=show_progress, on_iteration=on_iteration,
        )  # fmt: skip
        return _criticised(result, recording, settings)

    of_grasps = is_of_grasps(recording)
    if settings.method == "map":
        return element_map()
    try:
        found = _find(recording, settings, search)
    except UNCOMPUTABLE as error:
        if settings.method == "inclusions" or of_grasps or isinstance(error, CancelledError):
            raise
        reason = str(error).rstrip(".") or "not enough memory"
        warning = f"No inclusions can be fitted ({reason}); this is the element map."
        _log.warning("%s", warning)
        return element_map().with_warning(warning)
    is_explained = of_grasps or (not found.reasons and found.chi2 <= _MAX_CHI2)
    ended = found.stop_reason in (StopReason.INTERRUPTED, StopReason.TIME_LIMIT)
    if settings.method == "inclusions" or is_explained or ended:
        return found
    _log.info("Inclusions do not explain the presses; the element map is computed too.")
    return better_of(found, element_map(), recording, settings)


def _find(recording: Recording, settings: Settings, search: Mapping[str, Any]) -> Reconstruction:
    count, began = recording.mesh.n_tets, time.perf_counter()
    # All places of a palpation share one factorisation.
    if settings.method == "auto" and count > MAX_ELEMENTS and not is_palpation(recording):
        raise ConfigError(
            f"the mesh has {count} elements, more than {MAX_ELEMENTS}, and the fits would take "
            "much time and memory; method=inclusions fits them all the same"
        )
    shapes = find_shapes(recording, settings, **search)
    config = config_of(recording, settings)
    return of_inclusions(recording, shapes, config, time.perf_counter() - began)


def _criticised(result: Reconstruction, recording: Recording, settings: Settings) -> Reconstruction:
    """Return an element map, without lumps where it explains wrong forces as structure."""
    if result.reasons or result.stop_reason == StopReason.INTERRUPTED or is_palpation(recording):
        return result
    errors = _at_solution(result, recording, settings, "whether forces are wrong", force_errors)
    if errors is None or not errors.are_likely:
        return result
    reason = (
        f"its structure is better explained by forces that are wrong by about {errors.level:.0%}, "
        "which an element map takes for exact. Use method=inclusions, which allows for it, or "
        "check the calibration of the force sensor."
    )
    return replace(result, lumps=(), reasons=(reason,))


def better_of(
    inclusions: Reconstruction, elements: Reconstruction, recording: Recording, settings: Settings
) -> Reconstruction:
    """Return the description that predicts held-out contacts better, with the other one.

    The simpler one, by inclusions, is returned where the log-densities of all data differ by less
    than that of a model that is accepted in the search, and where they cannot be computed or are of
    different data, as those of a sensor's markers.
    """
    assert inclusions.shapes is not None
    if inclusions.shapes.through_gel:
        return replace(inclusions, other=elements)
    what = "how well the element map predicts held-out presses"
    score = _at_solution(elements, recording, settings, what, _held_out_score)
    scores = inclusions.shapes.held_out, score
    if None not in scores and inclusions.residuals is not None:
        gain = (scores[1] - scores[0]) * len(inclusions.residuals)  # type: ignore[operator]
        _log.info("held-out presses: log-density %+.4g by the element map", gain)
        if gain > MIN_GAIN and not elements.reasons:
            return replace(elements, other=inclusions)
    return replace(inclusions, other=elements)


def _held_out_score(point: Point, weight: float) -> float | None:
    """Return the score of an element map."""
    posterior, evaluation = LaplacePosterior.at(point, weight), point.evaluation
    contacts = contacts_of(point.objective.problem.recording)
    covariance = posterior.factor.inverse()
    return held_out_score(
        evaluation.data, contacts, evaluation.residuals, posterior.jacobian, covariance
    )


def _at_solution(
    result: Reconstruction,
    recording: Recording,
    settings: Settings,
    what: str,
    compute: Callable[[Point, float], _T | None],
) -> _T | None:
    """Return what is computed of an element map; None where it cannot be, which is logged."""
    try:
        return compute(solution(recording, result, settings), result.weight)
    except UNCOMPUTABLE as error:
        _log.info("%s is not known: %s", what, error)
        return None


def invert_map(
    recording: Recording,
    settings: Settings | None = None,
    *,
    start_mpa: Start = START_MPA,
    checkpoint: str | Path | None = None,
    resume: str | Path | None = None,
    show_progress: bool | None = None,
    on_iteration: Callable[[dict[str, Any], np.ndarray], None] | None = None,
) -> Reconstruction:
    """Reconstruct an element map, one modulus per element (eq. 8).

    The truth and the reference that a recording may carry are never read. An interruption
    (Ctrl-C) or the time limit keeps the best map so far.

    Args:
        recording: Presses on an object.
        settings: How to invert; Gauss-Newton on log-moduli with total variation by default.
        start_mpa: Start, one modulus for all elements or one each, MPa; or a function of the
            problem and the bounds that returns one: see `tactorch.inverse.fit.starts`.
        checkpoint: File to save the state to every few seconds.
        resume: Checkpoint to continue from.
        show_progress: Whether to show a line of progress; see `tactorch.progress.progress_line`.
        on_iteration: Callback with the record of each iteration and a copy of its map, MPa.

    Returns:
        The map with its history.

    Raises:
        ConfigError: a setting cannot be used.
        ConvergenceError: the start has no equilibrium under the recorded forces.
        FileError: the checkpoint to resume cannot be read.
    """
    settings = settings or Settings()
    optimizer = settings.optimizer
    label = f"inversion by {OPTIMIZERS.name_of(type(optimizer))}"
    with progress_line(label, show_progress) as update:
        update("model of the presses")
        objective = make_objective(recording, settings)
        monitor = Monitor(
            max_seconds=settings.max_seconds,
            checkpoint=None if checkpoint is None else Path(checkpoint),
            on_record=lambda record: update(
                f"iteration {record['iteration']}, misfit {record['misfit']:.3e} mm2, "
                f"step {record.get('step', 0.0):.2g}"
            ),
            on_iteration=on_iteration,
            identity={
                "mesh": recording.mesh.content_hash()[:12],
                "parameterization": str(objective.elements.parameterization),
                "model error": _describe_model_error(recording, settings),
                "nuisance": str(settings.nuisance),
                "misfit": MISFITS.name_of(type(settings.misfit)),
            },
            task=_task_digest(recording, settings),
        )
        if resume is not None:
            monitor.restore(Path(resume), objective.size)
            objective.problem.evaluations = monitor.evaluations
        update("first equilibrium")
        x = monitor.best
        if x is None:
            x = objective.start(start_map(start_mpa, objective.problem, settings.bounds))
        warn_of_assumed_noise(settings.noise, recording)
        if monitor.ended is None:
            with monitor:
                monitor.reason = reason = optimizer.minimize(objective, x, monitor)
                monitor.ended = None if reason.is_limit else reason
            monitor.save()
    result = of_elements(objective, settings, optimizer, monitor)
    return replace(result, config={"start_mpa": _describe_start(start_mpa), **result.config})


def warn_of_assumed_noise(noise: NoiseModel, recording: Recording) -> None:
    """Log a warning where the noise of some press is not stated."""
    if noise.assumed(recording):
        _log.warning(
            "The recording does not state its noise; %.2g of the signal is assumed "
            "(noise.relative). Too small a value overfits.",
            noise.relative,
        )


class ObjectiveBuilder:
    """Builds objectives for presses on one object; its bodies are made once."""

    def __init__(self, recording: Recording, settings: Settings) -> None:
        self.settings = settings
        self._palpation = is_palpation(recording)
        if is_of_grasps(recording):
            raise ConfigError(
                "Forces of grasps have no element map (method=map); tactorch invert gives the "
                "modulus and inclusions."
            )
        element = PALPATION_ELEMENT if self._palpation else settings.element
        self._body = make_body(recording, element, settings.solver, settings.newton)
        name = resolve_model_error(settings.model_error, recording, element)
        self.corrects = name == "discretisation" and not self._palpation
        self._finer: SoftBody | None = None

    def problem(self, recording: Recording) -> InverseProblem:
        """Return the inverse problem without a correction for the model's error."""
        kind = PalpationProblem if self._palpation else InverseProblem
        return kind(
            recording,
            noise=self.settings.noise,
            misfit=self.settings.misfit,
            nuisance=self.settings.nuisance,
            body=self._body,
        )

    def model_errors(self, problem: InverseProblem) -> tuple[ModelError, ...]:
        """Estimate the model's error of each press at the best uniform map, if it is corrected."""
        settings = self.settings
        if not self.corrects:
            return ()
        if self._finer is None:
            self._finer = make_body(problem.recording, "tet10", settings.solver, settings.newton)
        fit = uniform_fit(problem, settings.bounds, settings.nuisance)
        remaining = settings.residual_model_error_fraction
        return discretisation_error(problem, fit.youngs_mpa, fit.nuisance, remaining, self._finer)

    def _with_errors(self, problem: InverseProblem) -> InverseProblem:
        """Count the errors of the simplest model, linearised at the best uniform map."""
        presses = MeasuredPresses(problem)
        errors = ErrorModel(presses, [error for error in ERRORS if error.least(presses)])
        if errors.least:
            fit = uniform_fit(problem, self.settings.bounds, self.settings.nuisance)
            uniform = np.full(problem.n_elements, fit.youngs_mpa)
            evaluation = problem.evaluate(uniform, nuisance=fit.nuisance, chained=True)
            errors.linearise(evaluation, "linear", "quadratic")
        return problem.with_data(errors.data(errors.least))

    def objective(self, problem: InverseProblem, errors: Sequence[ModelError]) -> Objective:
        """Combine data, corrected for the model's error, with parameterisation and prior."""
        settings, mesh = self.settings, problem.recording.mesh
        if errors:
            problem = corrected(problem, errors)
        objective = Objective(
            self._with_errors(problem),
            ElementField(
                replace(settings.parameterization, bounds=settings.bounds),
                settings.regularization.on(mesh),
                mesh.n_tets,
            ),
            settings.nuisance,
            settings.regularization.weight,
            strong_contrast=self._palpation,
        )
        return _adapt(objective) if isinstance(settings.misfit, Adaptive) else objective


def _adapt(objective: Objective) -> Objective:
    """Return the objective with widened deviations of outlying presses, and least squares.

    A first inversion with the convex cost of `Adaptive` bounds the effect of a bad press on the
    map; it is damped Gauss-Newton with any optimizer. A press whose residuals there are larger than
    those of the median press (and than stated) gets their size as its deviation. Most presses must
    be as good as they state. A `Press` is one frame, so a bad frame of a good series is separate.
    """
    problem = objective.problem
    fit = uniform_fit(problem, objective.elements.parameterization.bounds, objective.nuisance)
    monitor = Monitor()
    start = objective.start(np.full(problem.n_elements, fit.youngs_mpa))
    GaussNewton(max_iterations=_ADAPT_ITERATIONS).minimize(
        replace(objective, weight=None), start, monitor
    )
    assert monitor.point is not None
    chi2 = np.array([np.mean(r**2) for r in monitor.point.evaluation.deviations])
    factors = np.sqrt(np.maximum(1.0, chi2 / max(1.0, float(np.median(chi2)))))
    for press, factor in zip(problem.recording.presses, factors, strict=True):
        if factor > _MIN_REPORTED:
            _log.warning(
                "%s is %.2g times as noisy as stated; its weight is reduced.", press.label, factor
            )
    data = replace(problem.data.widened(factors), misfit=Squares())
    return replace(objective, problem=problem.with_data(data))


def make_objective(recording: Recording, settings: Settings) -> Objective:
    """Combine data, parameterisation and prior.

    Raises:
        ConfigError: a setting cannot be used.
        ConvergenceError: the model's error is to be corrected or the misfit is adaptive, and all
            presses have an equilibrium with no uniform map.
    """
    builder = ObjectiveBuilder(recording, settings)
    problem = builder.problem(recording)
    return builder.objective(problem, builder.model_errors(problem))


def solution(recording: Recording, result: Reconstruction, settings: Settings) -> Point:
    """Return the point of the objective at the result of an inversion with these settings."""
    nuisance, m = settings.nuisance, len(result.youngs)
    if set(nuisance.names) != set(result.nuisance) or recording.mesh.n_tets != m:
        raise ConfigError(
            f"the result has {m} moduli and the nuisance parameters {sorted(result.nuisance)}, "
            f"recording and settings {recording.mesh.n_tets} and {sorted(nuisance.names)}; give "
            "those of the inversion."
        )
    objective = make_objective(recording, settings)
    x = objective.start(result.youngs)
    values = {name: estimate.value for name, estimate in result.nuisance.items()}
    x[m:] = nuisance.z(values, objective.problem.assumed)
    return objective.at(x)


def compute_posterior(
    recording: Recording, reconstruction: Reconstruction, settings: Settings | None = None
) -> GaussianPosterior:
    """Return the posterior of an element map.

    It is `variational_posterior` under total variation up to 2,000 parameters, otherwise
    `LaplacePosterior` up to 12,000, and `LowRankPosterior` beyond.

    Raises:
        ConfigError: settings and result do not match, or data and prior leave moduli undetermined.
        ConvergenceError: a press has no stable equilibrium at the map.
    """
    point = solution(recording, reconstruction, settings or Settings())
    return posterior_at(point, reconstruction.weight)


def _describe_model_error(recording: Recording, settings: Settings) -> str:
    """Correction for the model's error, as text that distinguishes runs."""
    name = resolve_model_error(settings.model_error, recording, settings.element)
    default = name == "none" or settings.residual_model_error_fraction == RESIDUAL_MODEL_ERROR
    return name if default else f"{name}, {settings.residual_model_error_fraction:g} left"


def _task_digest(recording: Recording, settings: Settings) -> str:
    """Digest of everything but the start and the time limit that decides the result."""
    digest = sha256(repr(to_mapping(replace(settings, max_seconds=None))).encode())
    body = (recording.material, recording.density, tuple(recording.gravity))
    digest.update(repr((body, settings.noise.deviations(recording))).encode())
    for press in recording.presses:
        support = (press.springs, press.fixed, press.prescribed)
        for array in (press.forces, press.displacement, press.weights, *support):
            digest.update(np.asarray(0 if array is None else array).tobytes())
        digest.update(press.readings_bytes())
    return digest.hexdigest()[:16]


def _describe_start(start: Start) -> float | str:
    if callable(start):
        return getattr(start, "__name__", type(start).__name__)
    return "a map, one modulus per element" if np.ndim(start) else float(start)

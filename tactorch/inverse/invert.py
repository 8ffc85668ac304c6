"""From a recording to a reconstruction, in one call."""

import logging
from collections.abc import Callable
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from tactorch.errors import ConfigError, ConvergenceError
from tactorch.fem import SoftBody
from tactorch.inverse.adaptive import adapt
from tactorch.inverse.misfit import MISFITS, Adaptive
from tactorch.inverse.model_error import (
    apply_model_error,
    discretisation_error,
    resolve_model_error,
)
from tactorch.inverse.monitor import Monitor, StopOptimization
from tactorch.inverse.noise import NoiseModel
from tactorch.inverse.nuisance_estimate import estimates
from tactorch.inverse.objective import Objective, Point
from tactorch.inverse.optimizers import OPTIMIZERS, Optimizer
from tactorch.inverse.problem import InverseProblem
from tactorch.inverse.progress import progress
from tactorch.inverse.reconstruction import Reconstruction
from tactorch.inverse.settings import RESIDUAL_MODEL_ERROR, Settings, stored_settings
from tactorch.inverse.starts import START_MPA, Start, start_map
from tactorch.inverse.uniform import uniform_fit
from tactorch.plain import plain
from tactorch.recording import Recording
from tactorch.versions import versions

_log = logging.getLogger(__name__)
INTERRUPTED = "interrupted"


def invert(
    recording: Recording,
    settings: Settings | None = None,
    *,
    start_mpa: Start = START_MPA,
    checkpoint: str | Path | None = None,
    resume: str | Path | None = None,
    show_progress: bool | None = None,
    on_iteration: Callable[[dict[str, Any], np.ndarray], None] | None = None,
) -> Reconstruction:
    """Reconstruct the map of Young's modulus (eq. 8).

    The truth and the reference that a recording may carry are never read. An interruption
    (Ctrl-C) or the time limit keeps the best map so far.

    Args:
        recording: Presses on an object.
        settings: How to invert; Gauss-Newton on log-moduli with total variation by default.
        start_mpa: Start, one modulus for all elements or one each, MPa; or a function of the
            problem and the bounds that returns one: see `tactorch.inverse.starts`.
        checkpoint: File to save the state to every few seconds.
        resume: Checkpoint to continue from.
        show_progress: Whether to show a progress line; by default at a terminal.
        on_iteration: Called with the record of each iteration and a copy of its map, MPa.

    Raises:
        ConfigError: a setting cannot be used.
        ConvergenceError: the start has no equilibrium under the recorded forces.
        FileError: the checkpoint to resume cannot be read.
    """
    settings = settings or Settings()
    objective = make_objective(recording, settings)
    optimizer = settings.optimizer
    path = None if checkpoint is None else Path(checkpoint)
    monitor = Monitor(
        max_seconds=settings.max_seconds,
        checkpoint=path,
        on_iteration=on_iteration,
        identity={
            "mesh": recording.mesh.content_hash()[:12],
            "parameterization": str(objective.parameterization),
            "model error": _of_model(recording, settings),
            "set of unknowns": str(settings.nuisance),
            "misfit": MISFITS.name_of(type(settings.misfit)),
        },
        task=_task(recording, settings, optimizer),
    )
    if resume is not None:
        monitor.restore(Path(resume), objective.size)
        objective.problem.evaluations = monitor.evaluations
    x = monitor.best
    if x is None:
        first = start_map(start_mpa, objective.problem, settings.bounds)
        x = objective.start(first)
    tell_assumed_noise(settings.noise, recording)
    reason = monitor.ended
    if not reason:
        with progress(OPTIMIZERS.name_of(type(optimizer)), show_progress) as update:
            monitor.on_record = update
            reason = run_to_end(optimizer, objective, x, monitor)
        monitor.save()
    found = result_of(recording, settings, optimizer, objective, monitor, reason)
    return replace(found, config={"start_mpa": _described(start_mpa), **found.config})


def tell_assumed_noise(noise: NoiseModel, recording: Recording) -> None:
    """Warn where the noise is assumed, for want of a statement."""
    if noise.assumed(recording):
        _log.warning(
            "The recording does not state its noise; %.2g of the signal is assumed "
            "(noise.relative). Too small a value overfits.",
            noise.relative,
        )


def make_objective(recording: Recording, settings: Settings) -> Objective:
    """Combine data, parameterisation and prior as the settings say.

    Raises:
        ConfigError: a setting cannot be used.
        ConvergenceError: the model's error is asked for, and no uniform map carries the presses.
    """
    problem = make_problem(recording, settings)
    if resolve_model_error(settings.model_error, recording, settings.element) == "discretisation":
        fit = uniform_fit(problem, settings.bounds, settings.nuisance)
        left = settings.residual_model_error_fraction
        apply_model_error(
            problem, discretisation_error(problem, fit.youngs_mpa, fit.nuisance, left)
        )
    return combine(problem, settings)


def make_problem(
    recording: Recording, settings: Settings, body: SoftBody | None = None
) -> InverseProblem:
    """Return the data as the settings have them, their model's error not counted yet.

    Args:
        recording: Presses on an object.
        settings: Of the inversion.
        body: The object as the settings have it, where it is there already.

    Raises:
        ConfigError: a setting cannot be used.
    """
    problem = InverseProblem(
        recording,
        element=settings.element,
        solver=settings.solver,
        noise=settings.noise,
        newton=settings.newton,
        misfit=settings.misfit,
        body=body,
    )
    problem.nuisance = settings.nuisance
    return problem


def combine(problem: InverseProblem, settings: Settings) -> Objective:
    """Combine data, whose model's error is counted, with parameterisation and prior.

    Raises:
        ConfigError: a setting cannot be used.
    """
    mesh = problem.recording.mesh
    objective = Objective(
        problem,
        replace(settings.parameterization, bounds=settings.bounds),
        settings.regularization.on(mesh),
        settings.nuisance,
        settings.regularization.weight,
    )
    if isinstance(settings.misfit, Adaptive):
        adapt(objective)
    return objective


def solution(recording: Recording, found: Reconstruction, settings: Settings) -> Point:
    """Return the point of the objective at which an inversion has ended.

    Args:
        recording: Presses that were inverted.
        found: Result.
        settings: Settings of the inversion.

    Raises:
        ConfigError: the settings free other nuisance parameters than the result has, or the
            recording has another mesh.
        ConvergenceError: a press has no equilibrium there.
    """
    free = settings.nuisance
    if set(free.names) != set(found.nuisance) or recording.mesh.n_tets != len(found.youngs):
        raise ConfigError(
            f"the result has {len(found.youngs)} moduli and the free parameters "
            f"{sorted(found.nuisance)}, recording and settings {recording.mesh.n_tets} and "
            f"{sorted(free.names)}; give those of the inversion."
        )
    objective = make_objective(recording, settings)
    values = {name: estimate.value for name, estimate in found.nuisance.items()}
    x = objective.start(found.youngs)
    x[len(found.youngs) :] = free.z(values, objective.problem.assumed)
    return objective.at(x)


def _of_model(recording: Recording, settings: Settings) -> str:
    """What is done about the model's error, in words by which runs are told apart."""
    name = resolve_model_error(settings.model_error, recording, settings.element)
    usual = name == "none" or settings.residual_model_error_fraction == RESIDUAL_MODEL_ERROR
    return name if usual else f"{name}, {settings.residual_model_error_fraction:g} left"


def _task(recording: Recording, settings: Settings, optimizer: Optimizer) -> str:
    """Everything but the start that decides the result, in few characters."""
    digest = sha256(repr(stored_settings(replace(settings, max_seconds=None))).encode())
    digest.update(repr(recording.material).encode())
    digest.update(repr(settings.noise.deviations(recording)).encode())
    for press in recording.presses:
        held = (press.springs, press.fixed, press.prescribed)
        for array in (press.forces, press.displacement, press.weights, *held):
            digest.update(np.asarray(0 if array is None else array).tobytes())
    return digest.hexdigest()[:16]


def _described(start: Start) -> float | str:
    """A start in words that fit a config."""
    if callable(start):
        return getattr(start, "__name__", type(start).__name__)
    return "a map, one modulus an element" if np.ndim(start) else float(start)


def run_to_end(optimizer: Optimizer, objective: Objective, x: np.ndarray, monitor: Monitor) -> str:
    """Run an optimizer, and return why it ended; interruptions keep the monitor's best so far."""
    try:
        reason = optimizer.minimize(objective, x, monitor)
        monitor.ended = "" if reason.endswith("limit reached") else reason
        return reason
    except StopOptimization:
        return "time limit reached"
    except KeyboardInterrupt:
        if monitor.best is None:
            raise
        return INTERRUPTED
    except ConvergenceError as error:  # an unstable equilibrium has no derivatives
        if monitor.point is None:
            raise
        return f"no derivatives at the best map: {error}"


def result_of(
    recording: Recording,
    settings: Settings,
    optimizer: Optimizer,
    objective: Objective,
    monitor: Monitor,
    reason: str,
) -> Reconstruction:
    """Return what an optimizer that has ended has found."""
    point = monitor.point
    if point is None:  # resumed and stopped before a step
        assert monitor.best is not None
        point = objective.at(monitor.best)
    n = recording.mesh.n_points
    return Reconstruction(
        mesh=recording.mesh,
        youngs=point.youngs,
        displacements=np.stack([u[:n] for u in point.evaluation.displacements]),
        history=monitor.history,
        stop_reason=reason,
        seconds=monitor.seconds,
        nuisance=estimates(point, monitor.history[-1].get("weight", 0.0)),
        config={
            "settings": stored_settings(settings),
            "optimizer": stored_settings(optimizer, "optimizer"),
            "material": plain(recording.material),
            "recording": recording.provenance,
            "versions": versions(),
        },
    )

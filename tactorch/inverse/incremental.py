"""An inversion to which presses are added: each time from the map and the weight of the last one.

What costs the most in a first inversion is done once. The bodies and the patterns of their
equations are kept. A press's error of the mesh is estimated when it comes, at the uniform modulus
that fits this press best (`invert` takes the one that fits all presses, for each anew): the error
hardly depends on the map, so it need not be estimated again. The prior's weight, whose search from
far above takes most of the iterations, begins where the last inversion had left it.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError, ConvergenceError, RecordingError
from tactorch.inverse.invert import (
    INTERRUPTED,
    combine,
    make_problem,
    result_of,
    run_to_end,
    tell_assumed_noise,
)
from tactorch.inverse.model_error import (
    ModelError,
    apply_model_error,
    discretisation_error,
    resolve_model_error,
)
from tactorch.inverse.monitor import Monitor
from tactorch.inverse.objective import Objective, Point
from tactorch.inverse.optimizers import OPTIMIZERS, GaussNewton, NewtonCG
from tactorch.inverse.optimizers.weight import warm_start_state
from tactorch.inverse.problem import body_of
from tactorch.inverse.reconstruction import Reconstruction
from tactorch.inverse.settings import Settings
from tactorch.inverse.starts import START_MPA, Start, homogeneous, start_map
from tactorch.inverse.uniform import uniform_fit
from tactorch.recording import Press, Recording

_WEIGHT = ("weight", "first_weight", "ended")
StopCondition: TypeAlias = Callable[[list[dict[str, Any]]], bool]


@dataclass(frozen=True, eq=False)
class IncrementalResult:
    """The map of all presses so far.

    Attributes:
        result: The reconstruction; its history and seconds are those of this update.
        point: The point of the objective where it ended.
        weight: Of the prior there.
        settled: Whether the optimizer came to its own end, and not to the limit of an update.
    """

    result: Reconstruction
    point: Point
    weight: float
    settled: bool


@dataclass(frozen=True, eq=False)
class _State:
    """What one update leaves to the next."""

    presses: tuple[Press, ...] = ()
    errors: tuple[tuple[Float[np.ndarray, " _"], float], ...] = ()  # offset and deviation, mm
    youngs: Float[np.ndarray, " m"] | None = None  # MPa
    weight: Mapping[str, float] = field(default_factory=dict)


class IncrementalInversion:
    """Inverts presses on one object as they come.

    Args:
        about: The object: mesh, material, and what else a recording has but for its presses.
        settings: Of the inversions. Nuisance parameters are not for it.
        start_mpa: Where the first one starts.
        max_iterations: Of one update; the next one goes on from there.
        max_seconds_per_update: Of one update. It ends before the iteration that would exceed it,
            but            makes one at the least.
    """

    def __init__(
        self,
        about: Recording,
        settings: Settings | None = None,
        *,
        start_mpa: Start = START_MPA,
        max_iterations: int = 8,
        max_seconds_per_update: float | None = None,
    ) -> None:
        """Set up the bodies.

        Raises:
            ConfigError: a setting cannot be used.
        """
        self._settings = settings or Settings()
        self._about, self._start = about, start_mpa
        self._optimizer = _optimizer_of(self._settings, max_iterations)
        self._limit, self._most_seconds = max_iterations, max_seconds_per_update
        element, solver, newton = (
            self._settings.element,
            self._settings.solver,
            self._settings.newton,
        )
        self._corrects = resolve_model_error(self._settings.model_error, about, element) != "none"
        self._body = body_of(about, element, solver, newton)
        self._finer = body_of(about, "tet10", solver, newton) if self._corrects else None
        self._state = _State()

    @property
    def presses(self) -> tuple[Press, ...]:
        """All presses so far."""
        return self._state.presses

    @property
    def recording(self) -> Recording:
        """The object with all presses so far.

        Raises:
            RecordingError: there is none yet.
        """
        return self._with(self._state.presses)

    def add(self, presses: Sequence[Press]) -> IncrementalResult:
        """Invert all presses so far and these, from the map before.

        Where this fails, or is interrupted, everything is as before.

        Raises:
            RecordingError: a press does not fit the object, or moved nothing.
            ConvergenceError: no uniform map carries a press, nor does the map before.
            KeyboardInterrupt: Ctrl-C.
        """
        began, before = time.perf_counter(), self._state
        self._check(presses)
        errors = before.errors + tuple(self._error(press) for press in presses)
        every = (*before.presses, *presses)
        first = len(before.presses) or len(every)
        weight = warm_start_state(dict(before.weight), len(every) / first)
        until = None if self._most_seconds is None else began + self._most_seconds
        stop_condition = None if until is None else _before(until)
        return self._invert(every, errors, weight, self._limit, stop_condition)

    def refine(
        self, max_iterations: int = 60, *, stop: Callable[[], bool] = lambda: False
    ) -> IncrementalResult:
        """Go on with the presses that there are until the optimizer comes to its own end.

        Args:
            max_iterations: At which it ends.
            stop: Asked after each iteration whether to end there.

        Raises:
            RecordingError: there is no press yet.
            KeyboardInterrupt: Ctrl-C; everything is as before.
        """
        now = self._state
        weight = warm_start_state(dict(now.weight), 1.0)
        stop_condition = _stopped(stop)
        return self._invert(now.presses, now.errors, weight, max_iterations, stop_condition)

    def state(self) -> dict[str, np.ndarray]:
        """Return what `restore` needs beside the presses, as arrays."""
        now = self._state
        assert now.youngs is not None
        offsets = [offset for offset, _ in now.errors]
        return {
            "youngs": now.youngs,
            "weight": np.array([now.weight.get(name, np.nan) for name in _WEIGHT]),
            "offsets": np.concatenate(offsets) if offsets else np.zeros(0),
            "counts": np.array([len(offset) for offset in offsets], dtype=np.int64),
            "deviations": np.array([deviation for _, deviation in now.errors]),
        }

    def restore(self, presses: Sequence[Press], state: Mapping[str, np.ndarray]) -> Point:
        """Go on where `state` was taken, with the presses that there were; returns that point.

        Raises:
            ConfigError: the state is of other presses, or of another mesh.
            ConvergenceError: the presses have no equilibrium at the map.
        """
        youngs, counts = state["youngs"], state["counts"]
        m, n = self._about.mesh.n_tets, len(presses)
        fits = youngs.shape == (m,) and len(counts) == len(state["deviations"])
        if not fits or len(counts) != n:
            raise ConfigError(
                f"the state is of {len(youngs)} elements and {len(counts)} presses, not of {m} and "
                f"{n}; start anew."
            )
        offsets = np.split(state["offsets"], np.cumsum(counts)[:-1]) if n else []
        errors = tuple(zip(offsets, (float(d) for d in state["deviations"]), strict=True))
        known = dict(zip(_WEIGHT, map(float, state["weight"]), strict=True))
        weight = {} if np.isnan(known["weight"]) else known
        self._state = _State(tuple(presses), errors, youngs, weight)
        objective = self._objective(self._state.presses, errors)
        return objective.at(objective.start(youngs))

    def _with(self, presses: Sequence[Press]) -> Recording:
        # Magnitudes are checked where presses are read: one by itself may be small.
        return replace(self._about, presses=tuple(presses), check_units=False)

    def _check(self, presses: Sequence[Press]) -> None:
        for number, press in enumerate(presses, start=len(self._state.presses) + 1):
            press.validate(self._about.mesh.n_points)
            if not press.displacement[press.data].any():
                label = f"press {number}" + (f" ('{press.name}')" if press.name else "")
                raise RecordingError(
                    f"{label}: all its observed displacements are zero, so it says nothing of the "
                    "object; leave it out, or give what moved."
                )
        if not self._state.presses:
            tell_assumed_noise(self._settings.noise, self._with(presses))

    def _error(self, press: Press) -> tuple[np.ndarray, float]:
        """What the mesh gets wrong of one press: offset and deviation, mm."""
        problem = make_problem(self._with([press]), self._settings, self._body)
        if not self._corrects:
            return np.zeros(problem.n_data), 0.0
        fit = uniform_fit(problem, self._settings.bounds)
        found = discretisation_error(
            problem,
            fit.youngs_mpa,
            left=self._settings.residual_model_error_fraction,
            finer=self._finer,
        )
        return found.offset[0], found.deviation[0]

    def _objective(
        self, presses: Sequence[Press], errors: Sequence[tuple[np.ndarray, float]]
    ) -> Objective:
        problem = make_problem(self._with(presses), self._settings, self._body)
        if self._corrects:
            apply_model_error(problem, ModelError([e[0] for e in errors], [e[1] for e in errors]))
        return combine(problem, self._settings)

    def _invert(
        self,
        presses: tuple[Press, ...],
        errors: tuple[tuple[np.ndarray, float], ...],
        weight: dict[str, float],
        most: int,
        stop_condition: StopCondition | None,
    ) -> IncrementalResult:
        objective = self._objective(presses, errors)
        optimizer = replace(self._optimizer, max_iterations=most)
        monitor, reason = self._run(objective, optimizer, weight, stop_condition)
        if reason == INTERRUPTED:
            raise KeyboardInterrupt
        assert monitor.point is not None
        found = monitor.state
        kept = {name: found[name] for name in _WEIGHT} if "weight" in found else {}
        self._state = _State(presses, errors, monitor.point.youngs, kept)
        recording = objective.problem.recording
        result = result_of(recording, self._settings, optimizer, objective, monitor, reason)
        last = float(monitor.history[-1].get("weight", 0.0))
        return IncrementalResult(result, monitor.point, last, not reason.endswith("limit reached"))

    def _run(
        self,
        objective: Objective,
        optimizer: GaussNewton | NewtonCG,
        weight: dict[str, float],
        stop_condition: StopCondition | None,
    ) -> tuple[Monitor, str]:
        """Run from the map before, or from a uniform one that carries all presses."""
        bounds, before = self._settings.bounds, self._state.youngs
        starts: list[Any] = [self._start if before is None else before, homogeneous]
        for start in starts:
            limit = self._settings.max_seconds
            monitor = Monitor(max_seconds=limit, state=dict(weight), stop_condition=stop_condition)
            x = objective.start(start_map(start, objective.problem, bounds))
            try:
                return monitor, run_to_end(optimizer, objective, x, monitor)
            except ConvergenceError:
                if start is homogeneous:
                    raise
                weight = {}
        raise AssertionError  # the last start returns or raises


def _before(until: float) -> StopCondition:
    """Enough is where an iteration as long as the last one would end after `until`."""

    def stop_condition(history: list[dict[str, Any]]) -> bool:
        if len(history) < 2:  # the first record is of the map before
            return False
        last = history[-1]["seconds"] - history[-2]["seconds"]
        return time.perf_counter() + last > until

    return stop_condition


def _stopped(stop: Callable[[], bool]) -> StopCondition:
    return lambda history: len(history) > 1 and stop()


def _optimizer_of(settings: Settings, max_iterations: int) -> GaussNewton | NewtonCG:
    if settings.nuisance.size:
        raise ConfigError(
            "nuisance: a map that grows press by press does not know nuisance parameters; estimate "
            "them from a recording first (tactorch invert), and give nuisance=none here."
        )
    if max_iterations < 1:
        raise ConfigError(f"max_iterations={max_iterations}: give at least 1.")
    optimizer = settings.optimizer
    if not isinstance(optimizer, GaussNewton | NewtonCG):
        raise ConfigError(
            f"optimizer={OPTIMIZERS.name_of(type(optimizer))} cannot continue from the map before; "
            "choose gauss_newton, or newton_cg beyond ten thousand elements."
        )
    return optimizer

"""An inversion to which presses are added: each continues from the map and weight of the last one.

The expensive parts of a first inversion are done once. Bodies and the patterns of their equations
are kept. The model's error of a press is estimated when it is added, at the uniform modulus that
fits this press best (`invert` uses the one that fits all presses): it hardly depends on the map.
The weight of the prior, whose search takes most of the iterations, starts where the last inversion
ended.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError, ConvergenceError, RecordingError
from tactorch.inverse.invert import ObjectiveBuilder, result_of, warn_of_assumed_noise
from tactorch.inverse.model_error import ModelError
from tactorch.inverse.monitor import Monitor, StopCondition, StopReason
from tactorch.inverse.objective import Objective, Point
from tactorch.inverse.optimizers import OPTIMIZERS, Optimizer
from tactorch.inverse.optimizers.damped import DampedNewton
from tactorch.inverse.optimizers.schedule import warm_start_state
from tactorch.inverse.reconstruction import Reconstruction
from tactorch.inverse.settings import Settings
from tactorch.inverse.starts import START_MPA, Start, homogeneous, start_map
from tactorch.recording import Press, Recording

_WEIGHT = ("weight", "first_weight", "ended")


@dataclass(frozen=True, eq=False)
class IncrementalResult:
    """The map of all presses so far.

    Attributes:
        result: The reconstruction; its history and seconds are those of this update.
        point: The point of the objective at the map.
        weight: Weight of the prior.
        converged: Whether the optimizer converged, rather than reaching the limit of an update.
    """

    result: Reconstruction
    point: Point
    weight: float
    converged: bool


@dataclass(frozen=True, eq=False)
class _State:
    """State between two updates."""

    presses: tuple[Press, ...] = ()
    errors: tuple[tuple[Float[np.ndarray, " _"], float], ...] = ()  # offset and deviation, mm
    youngs: Float[np.ndarray, " m"] | None = None  # MPa
    weight: Mapping[str, float] = field(default_factory=dict)


class IncrementalInversion:
    """Inverts presses on one object as they arrive.

    Args:
        recording: The object: mesh, material, and everything else but presses.
        settings: Settings of the inversions, without nuisance parameters.
        start_mpa: Start of the first one.
        max_iterations: Limit of one update; the next one continues from there.
        max_seconds_per_update: Time limit of one update, s. It ends before the iteration that would
            exceed it, but after one iteration or more.
        restart: Invert all presses like `invert` in every `add`, from the present map, by any
            optimizer and without a limit of an update; Ctrl-C then keeps the best map.
    """

    def __init__(
        self,
        recording: Recording,
        settings: Settings | None = None,
        *,
        start_mpa: Start = START_MPA,
        max_iterations: int = 8,
        max_seconds_per_update: float | None = None,
        restart: bool = False,
    ) -> None:
        """Make the bodies.

        Raises:
            ConfigError: a setting cannot be used.
        """
        self._settings = settings or Settings()
        self._object, self._start, self._restart = recording, start_mpa, restart
        _check_settings(self._settings, max_iterations, restart)
        self._max_iterations, self._max_seconds = max_iterations, max_seconds_per_update
        self._builder = ObjectiveBuilder(recording, self._settings)
        self._state = _State()

    @property
    def presses(self) -> tuple[Press, ...]:
        """All presses so far."""
        return self._state.presses

    @property
    def recording(self) -> Recording:
        """The object with all presses so far.

        Raises:
            RecordingError: there is no press yet.
        """
        return self._with(self._state.presses)

    def add(self, presses: Sequence[Press]) -> IncrementalResult:
        """Invert all presses so far together with new ones, from the present map.

        A failure or an interruption leaves the state unchanged.

        Args:
            presses: New presses.

        Returns:
            The map of all presses.

        Raises:
            RecordingError: a press does not fit the object, or has zero displacements.
            ConvergenceError: neither a uniform map nor the present one carries a press.
            KeyboardInterrupt: Ctrl-C.
        """
        began, state = time.perf_counter(), self._state
        self._check(presses)
        together = (*state.presses, *presses)
        if self._restart:
            return self._invert(together, self._model_errors(together), {}, None, None)
        errors = sum((self._model_errors([press]) for press in presses), state.errors)
        growth = len(together) / (len(state.presses) or len(together))
        weight = warm_start_state(dict(state.weight), growth)
        limit = self._max_seconds
        stop_condition = None if limit is None else _ends_before(began + limit)
        return self._invert(together, errors, weight, self._max_iterations, stop_condition)

    def refine(
        self, max_iterations: int = 60, *, stop: Callable[[], bool] = lambda: False
    ) -> IncrementalResult:
        """Continue with the present presses until the optimizer converges.

        Args:
            max_iterations: Limit of iterations.
            stop: Called after each iteration; returns whether to stop.

        Returns:
            The map of all presses.

        Raises:
            RecordingError: there is no press yet.
            KeyboardInterrupt: Ctrl-C; the state is unchanged.
        """

        def stop_condition(history: list[dict[str, Any]]) -> StopReason | None:
            return StopReason.STOPPED if len(history) > 1 and stop() else None

        state = self._state
        weight = warm_start_state(dict(state.weight), 1.0)
        return self._invert(state.presses, state.errors, weight, max_iterations, stop_condition)

    def state(self) -> dict[str, np.ndarray]:
        """Return the arrays that `restore` needs in addition to the presses."""
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
        """Continue from a state, with the presses of that time.

        Args:
            presses: All presses at the time of the state.
            state: What `state` returned.

        Returns:
            The point of the objective at the map.

        Raises:
            ConfigError: the state belongs to other presses, or to another mesh.
            ConvergenceError: the presses have no equilibrium at the map.
        """
        youngs, counts = state["youngs"], state["counts"]
        m, n = self._object.mesh.n_tets, len(presses)
        fits = youngs.shape == (m,) and len(counts) == len(state["deviations"])
        if not fits or len(counts) != n:
            raise ConfigError(
                f"the state has {len(youngs)} elements and {len(counts)} presses, not {m} and {n}; "
                "start again without it."
            )
        offsets = np.split(state["offsets"], np.cumsum(counts)[:-1]) if n else []
        errors = tuple(zip(offsets, (float(d) for d in state["deviations"]), strict=True))
        known = dict(zip(_WEIGHT, map(float, state["weight"]), strict=True))
        weight = {} if np.isnan(known["weight"]) else known
        self._state = _State(tuple(presses), errors, youngs, weight)
        objective = self._objective(self._state.presses, errors)
        return objective.at(objective.start(youngs))

    def _with(self, presses: Sequence[Press]) -> Recording:
        # Magnitudes are checked where presses are read; a single press may be small.
        return replace(self._object, presses=tuple(presses), check_units=False)

    def _check(self, presses: Sequence[Press]) -> None:
        for number, press in enumerate(presses, start=len(self._state.presses) + 1):
            press.validate(self._object.mesh.n_points)
            if not press.displacement[press.data].any():
                label = f"press {number}" + (f" ('{press.name}')" if press.name else "")
                raise RecordingError(
                    f"{label}: all its observed displacements are zero, so it is uninformative; "
                    "remove it, or give its displacements."
                )
        if not self._state.presses:
            warn_of_assumed_noise(self._settings.noise, self._with(presses))

    def _model_errors(self, presses: Sequence[Press]) -> tuple[tuple[np.ndarray, float], ...]:
        """Model's error of each press (offset and deviation, mm) at the modulus that fits best."""
        error = self._builder.model_error(self._builder.problem(self._with(presses)))
        if error is None:
            return ((np.zeros(0), 0.0),) * len(presses)
        return tuple(zip(error.offset, error.deviation, strict=True))

    def _objective(
        self, presses: Sequence[Press], errors: Sequence[tuple[np.ndarray, float]]
    ) -> Objective:
        error = ModelError([offset for offset, _ in errors], [deviation for _, deviation in errors])
        problem = self._builder.problem(self._with(presses))
        return self._builder.objective(problem, error if self._builder.corrects else None)

    def _invert(
        self,
        presses: tuple[Press, ...],
        errors: tuple[tuple[np.ndarray, float], ...],
        weight: dict[str, float],
        max_iterations: int | None,
        stop_condition: StopCondition | None,
    ) -> IncrementalResult:
        objective = self._objective(presses, errors)
        optimizer = self._settings.optimizer
        if isinstance(optimizer, DampedNewton) and max_iterations is not None:
            optimizer = replace(optimizer, max_iterations=max_iterations)
        monitor, reason = self._run(objective, optimizer, weight, stop_condition)
        if reason is StopReason.INTERRUPTED and not self._restart:
            raise KeyboardInterrupt
        assert monitor.point is not None
        state = monitor.state
        stored = {name: state[name] for name in _WEIGHT} if "weight" in state else {}
        self._state = _State(presses, errors, monitor.point.youngs, stored)
        result = result_of(objective, self._settings, optimizer, monitor, reason)
        last = float(monitor.history[-1].get("weight", 0.0))
        converged = self._restart or not reason.is_limit
        return IncrementalResult(result, monitor.point, last, converged)

    def _run(
        self,
        objective: Objective,
        optimizer: Optimizer,
        weight: dict[str, float],
        stop_condition: StopCondition | None,
    ) -> tuple[Monitor, StopReason]:
        """Run from the present map, or from a uniform one that carries all presses."""
        bounds, present = self._settings.bounds, self._state.youngs
        starts: list[Any] = [self._start if present is None else present, homogeneous]
        for start in starts:
            limit = self._settings.max_seconds
            monitor = Monitor(max_seconds=limit, state=dict(weight), stop_condition=stop_condition)
            x = objective.start(start_map(start, objective.problem, bounds))
            try:
                return monitor, optimizer.run(objective, x, monitor)
            except ConvergenceError:
                if start is homogeneous:
                    raise
                weight = {}
        raise AssertionError  # the last start returns or raises


def _ends_before(deadline: float) -> StopCondition:
    """Stop where an iteration as long as the last one would end after the deadline."""

    def stop_condition(history: list[dict[str, Any]]) -> StopReason | None:
        if len(history) < 2:  # the first record is that of the start
            return None
        last = history[-1]["seconds"] - history[-2]["seconds"]
        return StopReason.TIME_LIMIT if time.perf_counter() + last > deadline else None

    return stop_condition


def _check_settings(settings: Settings, max_iterations: int, restart: bool) -> None:
    if settings.nuisance.size:
        raise ConfigError(
            "nuisance: an incremental inversion does not estimate nuisance parameters; estimate "
            "them from a recording first (tactorch invert), and give nuisance=none here."
        )
    if max_iterations < 1:
        raise ConfigError(f"max_iterations={max_iterations}: give at least 1.")
    optimizer = settings.optimizer
    if not (restart or isinstance(optimizer, DampedNewton)):
        raise ConfigError(
            f"optimizer={OPTIMIZERS.name_of(type(optimizer))} cannot continue from the map before; "
            "choose gauss_newton, or newton_cg beyond ten thousand elements."
        )

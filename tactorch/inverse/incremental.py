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
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError, ConvergenceError, RecordingError
from tactorch.inverse.errors.discretisation import ModelError
from tactorch.inverse.fit.monitor import Monitor, StopCondition, StopReason
from tactorch.inverse.fit.objective import Point
from tactorch.inverse.fit.optimizers.base import OPTIMIZERS
from tactorch.inverse.fit.optimizers.damped import DampedNewton
from tactorch.inverse.fit.optimizers.schedule import warm_start_state
from tactorch.inverse.fit.settings import Settings
from tactorch.inverse.fit.starts import START_MPA, Start, homogeneous, start_map
from tactorch.inverse.forward.problem import InverseProblem
from tactorch.inverse.invert import ObjectiveBuilder, warn_of_assumed_noise
from tactorch.inverse.result.build import of_elements
from tactorch.inverse.result.reconstruction import Reconstruction
from tactorch.recording import Press, Recording

_WEIGHT = ("weight", "first_weight", "ended")


class IncrementalResult(NamedTuple):
    """The map of all presses so far: the reconstruction, its point and the weight of the prior.

    History and seconds are those of this update. It has `converged` where the optimizer ended
    before the limit of an update.
    """

    result: Reconstruction
    point: Point
    weight: float
    converged: bool


@dataclass(frozen=True, eq=False)
class _State:
    presses: tuple[Press, ...] = ()
    errors: tuple[ModelError, ...] = ()  # of each press, or none
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
        self._settings = settings or Settings()
        self._object, self._start, self._restart = recording, start_mpa, restart
        if self._settings.nuisance.size:
            raise ConfigError(
                "nuisance: an incremental inversion does not estimate nuisance parameters; "
                "estimate them from a recording first (tactorch invert), and give nuisance=none "
                "here."
            )
        if max_iterations < 1:
            raise ConfigError(f"max_iterations={max_iterations}: give at least 1.")
        if not (restart or isinstance(optimizer := self._settings.optimizer, DampedNewton)):
            raise ConfigError(
                f"optimizer={OPTIMIZERS.name_of(type(optimizer))} cannot continue from the map "
                "before; choose gauss_newton, or newton_cg beyond ten thousand elements."
            )
        self._max_iterations, self._max_seconds = max_iterations, max_seconds_per_update
        self._builder = ObjectiveBuilder(recording, self._settings)
        self._state = _State()

    @property
    def recording(self) -> Recording:
        """The object with all presses so far, of which there must be one."""
        return self._with(self._state.presses)

    def add(self, presses: Sequence[Press]) -> IncrementalResult:
        """Invert all presses so far together with new ones, from the present map.

        A failure or an interruption leaves the state unchanged.

        Raises:
            RecordingError: a press does not fit the object, or has zero displacements.
            ConvergenceError: a press has no equilibrium at the present map, nor at a uniform one.
            KeyboardInterrupt: Ctrl-C.
        """
        began, state = time.perf_counter(), self._state
        self._check(presses)
        together = (*state.presses, *presses)
        if self._restart:
            errors = self._builder.model_errors(self._problem(together))
            return self._invert(together, errors, None, None, None)
        new = (self._builder.model_errors(self._problem([press])) for press in presses)
        errors = sum(new, state.errors)

        def ends_before_limit(history: list[dict[str, Any]]) -> StopReason | None:
            # The first record is that of the start; the next iteration takes as long as the last.
            if self._max_seconds is None or len(history) < 2:
                return None
            end = time.perf_counter() + history[-1]["seconds"] - history[-2]["seconds"]
            return StopReason.TIME_LIMIT if end > began + self._max_seconds else None

        growth = len(together) / (len(state.presses) or len(together))
        return self._invert(together, errors, growth, self._max_iterations, ends_before_limit)

    def refine(
        self, max_iterations: int = 60, *, stop: Callable[[], bool] = lambda: False
    ) -> IncrementalResult:
        """Continue with the present presses until the optimizer converges or `stop` returns True.

        Ctrl-C leaves the state unchanged.
        """

        def stop_condition(history: list[dict[str, Any]]) -> StopReason | None:
            return StopReason.STOPPED if len(history) > 1 and stop() else None

        state = self._state
        return self._invert(state.presses, state.errors, 1.0, max_iterations, stop_condition)

    def state(self) -> dict[str, np.ndarray]:
        """Return the arrays that `restore` needs in addition to the presses."""
        state = self._state
        assert state.youngs is not None
        # A press without a correction has an error of no data.
        errors = state.errors or (ModelError(np.zeros(0), 0.0),) * len(state.presses)
        offsets = [error.offset for error in errors]
        return {
            "youngs": state.youngs,
            "weight": np.array([state.weight.get(name, np.nan) for name in _WEIGHT]),
            "offsets": np.concatenate(offsets),
            "counts": np.array([len(offset) for offset in offsets], dtype=np.int64),
            "deviations": np.array([error.deviation_mm for error in errors]),
        }

    def restore(self, presses: Sequence[Press], state: Mapping[str, np.ndarray]) -> Point:
        """Continue from what `state` returned, with the presses of that time.

        Returns:
            The point of the objective at the map.

        Raises:
            ConfigError: the state belongs to other presses, settings, or another mesh.
            ConvergenceError: the presses have no equilibrium at the map.
        """
        youngs, counts = state["youngs"], state["counts"].tolist()
        m, corrects = self._object.mesh.n_tets, self._builder.corrects
        problem = self._problem(presses)
        data = problem.data.counts if corrects else [0] * len(presses)
        if youngs.shape != (m,) or len(counts) != len(presses) or (corrects and counts != data):
            raise ConfigError(
                f"the state has {len(youngs)} elements and model errors of {counts} data, not {m} "
                f"and {data}; start again without it."
            )
        errors: tuple[ModelError, ...] = ()
        if corrects:
            offsets = np.split(state["offsets"], np.cumsum(counts)[:-1])
            errors = tuple(map(ModelError, offsets, state["deviations"].tolist()))
        known = dict(zip(_WEIGHT, map(float, state["weight"]), strict=True))
        weight = {} if np.isnan(known["weight"]) else known
        objective = self._builder.objective(problem, errors)
        point = objective.at(objective.start(youngs))
        self._state = _State(tuple(presses), errors, youngs, weight)
        return point

    def _with(self, presses: Sequence[Press]) -> Recording:
        # Magnitudes are checked where presses are read; a single press may be small.
        return replace(self._object, presses=tuple(presses), check_units=False)

    def _check(self, presses: Sequence[Press]) -> None:
        for number, press in enumerate(presses, start=len(self._state.presses) + 1):
            press.validate(self._object.mesh.n_points)
            if not (press.has_readings or press.displacement[press.data].any()):
                label = f"press {number}" + (f" ('{press.name}')" if press.name else "")
                raise RecordingError(
                    f"{label}: all its observed displacements are zero, so it is uninformative; "
                    "remove it, or give its displacements."
                )
        if not self._state.presses:
            warn_of_assumed_noise(self._settings.noise, self._with(presses))

    def _problem(self, presses: Sequence[Press]) -> InverseProblem:
        return self._builder.problem(self._with(presses))

    def _invert(
        self,
        presses: tuple[Press, ...],
        errors: tuple[ModelError, ...],
        growth: float | None,
        max_iterations: int | None,
        stop_condition: StopCondition | None,
    ) -> IncrementalResult:
        """Invert from the present map, or from a uniform one with equilibria of all presses.

        The amount of data is `growth` times that of the present weight of the prior; None forgets
        that weight.
        """
        objective = self._builder.objective(self._problem(presses), errors)
        optimizer = self._settings.optimizer
        if isinstance(optimizer, DampedNewton) and max_iterations is not None:
            optimizer = replace(optimizer, max_iterations=max_iterations)
        weight = {} if growth is None else warm_start_state(self._state.weight, growth)
        present = self._state.youngs
        starts: list[Any] = [self._start if present is None else present, homogeneous]
        for start in starts:
            monitor = Monitor(
                max_seconds=self._settings.max_seconds, state=weight, stop_condition=stop_condition
            )
            x = objective.start(start_map(start, objective.problem, self._settings.bounds))
            try:
                with monitor:
                    monitor.reason = optimizer.minimize(objective, x, monitor)
                break
            except ConvergenceError:
                if start is homogeneous:
                    raise
                weight = {}
        reason, point, state = monitor.reason, monitor.point, monitor.state
        if reason is StopReason.INTERRUPTED and not self._restart:
            raise KeyboardInterrupt
        assert point is not None
        assert reason is not None
        stored = {name: state[name] for name in _WEIGHT} if "weight" in state else {}
        self._state = _State(presses, errors, point.youngs, stored)
        result = of_elements(objective, self._settings, optimizer, monitor)
        last = float(monitor.history[-1].get("weight", 0.0))
        return IncrementalResult(result, point, last, self._restart or not reason.is_limit)

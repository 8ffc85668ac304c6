"""The damped Newton loop of all inversions: Levenberg-Marquardt steps within bounds.

Each step solves (H + weight * prior + damping) step = -gradient over the parameters that are not
held at a bound, with H the Gauss-Newton or the true Hessian of the misfit. A `StepSolver` solves
the system: in parameter space, in data space, or by conjugate gradients. The damping grows where
the objective falls less than predicted, and shrinks where it falls as predicted.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float

from tactorch.config import option
from tactorch.errors import ConvergenceError
from tactorch.inverse.monitor import Monitor, StopReason
from tactorch.inverse.objective import Objective, Point
from tactorch.inverse.optimizers.base import Optimizer, projected_gradient
from tactorch.inverse.optimizers.schedule import MIN_GAIN, RegularizationSchedule

# While the weight of the prior falls, the path follows a valley that is narrow where the noise is
# small: the misfit may rise by this factor, else the steps along it become tiny.
_MAX_RISE = 2.0
# Directions that the data do not determine are the prior's; damping is for the nonlinearity alone,
# so it starts small, falls after every step of sufficient gain, and jumps where a step failed.
_MIN_DAMPING, _MIN_RAISED_DAMPING = 1e-12, 1e-4


@runtime_checkable
class LinearSystem(Protocol):
    """The linearised problem at one point."""

    def solve(self, damping: float) -> Float[np.ndarray, " size"] | None:
        """Return the damped step, zero at held parameters; None where the system is singular."""
        ...

    def predicted_fall(self, change: Float[np.ndarray, " size"]) -> float:
        """Return the fall of the quadratic model along a change."""
        ...


class StepSolver(ABC):
    """Makes the linear systems of one run.

    Attributes:
        leaps: Whether the weight of the prior may fall by leaps.
        takes_over: Whether a trial takes the factorisations of the present point over.
    """

    leaps = True
    takes_over = False

    @abstractmethod
    def schedule(self, point: Point, state: dict[str, float]) -> RegularizationSchedule:
        """Return the schedule of the prior's weight, from the start or a stored state."""

    @abstractmethod
    def data_gradient(self, point: Point) -> Float[np.ndarray, " size"]:
        """Return the gradient of the misfit."""

    @abstractmethod
    def linearize(
        self,
        point: Point,
        weight: float,
        gradient: Float[np.ndarray, " size"],
        free: Bool[np.ndarray, " size"],
        lowering: bool,
    ) -> LinearSystem:
        """Return the linear system at a point.

        Args:
            point: Where.
            weight: Weight of the prior.
            gradient: Gradient of the objective.
            free: Parameters that are not held at a bound.
            lowering: Whether the weight still falls, so that the step need not be accurate.
        """

    def state(self) -> dict[str, float]:
        """Return the numbers to resume from."""
        return {}

    def record(self) -> dict[str, float]:
        """Return figures for the record of the iteration."""
        return {}


@dataclass(frozen=True, eq=False)
class _Step:
    """An accepted step: its end, the next damping, and its gain."""

    point: Point
    damping: float
    gain: float


@dataclass(frozen=True)
class DampedNewton(Optimizer):
    """Settings that the damped Newton methods have in common.

    Attributes:
        max_iterations: Limit of accepted steps.
        tolerance: Relative fall of the objective, at a final weight, at which to stop.
        damping: First damping, relative to the diagonal of the Hessian.
        max_trials: Limit of trial steps at one iterate.
    """

    max_iterations: int = option(60, "Limit of accepted steps", gt=0)
    tolerance: float = option(1e-3, "Relative fall of the objective at which to stop", gt=0)
    damping: float = option(1e-6, "First damping, relative to the Hessian's diagonal", gt=0)
    max_trials: int = option(12, "Limit of trial steps at one iterate", gt=0)

    @abstractmethod
    def step_solver(self, point: Point, state: dict[str, float]) -> StepSolver:
        """Return the solver of a run that starts at a point or from a stored state."""

    def minimize(
        self, objective: Objective, start: Float[np.ndarray, " size"], monitor: Monitor
    ) -> StopReason:
        """See `Optimizer.minimize`."""
        point = objective.at(start)
        solver = self.step_solver(point, monitor.state)
        schedule = solver.schedule(point, monitor.state)
        damping = monitor.state.get("damping", self.damping)

        def report(weight: float, step: float) -> None:
            monitor.state = {**schedule.state(), **solver.state(), "damping": damping}
            monitor.accept(
                point, objective=point.value(weight), weight=weight, step=step, damping=damping,
                **solver.record(),
            )  # fmt: skip

        if not monitor.history:
            report(schedule.weight, 0.0)
        while monitor.iteration < self.max_iterations:
            final = schedule.final
            step = self._advance(point, solver, schedule, damping, monitor)
            if step is None:
                return StopReason.NO_DESCENT
            weight, before = schedule.weight, point
            point, damping = step.point, step.damping
            fall = before.value(weight) - point.value(weight)
            schedule.update(point, step.gain if solver.leaps else np.nan)
            converged = final and fall <= self.tolerance * point.value(weight)
            done = not schedule.retry(point, converged=converged) and converged
            report(weight, float(np.abs(point.x - before.x).max()))
            if done:
                return schedule.ended or StopReason.CONVERGED
        return StopReason.ITERATION_LIMIT

    def _advance(
        self,
        point: Point,
        solver: StepSolver,
        schedule: RegularizationSchedule,
        damping: float,
        monitor: Monitor,
    ) -> _Step | None:
        """Make a step. A leap of the weight that leads to no sufficient step is retracted."""
        if schedule.leapt:
            step = self._step(point, solver, schedule.weight, damping, False, monitor, trials=1)
            if step is not None and step.gain >= MIN_GAIN:
                return step
            schedule.retract()
        lowering = not (schedule.final or schedule.held)
        step = self._step(point, solver, schedule.weight, damping, lowering, monitor)
        if step is None and schedule.held:
            step = self._step(point, solver, schedule.weight, damping, True, monitor)
        return step

    def _step(
        self,
        point: Point,
        solver: StepSolver,
        weight: float,
        damping: float,
        lowering: bool,
        monitor: Monitor,
        trials: int | None = None,
    ) -> _Step | None:
        """Try steps of growing damping; while the weight falls, the misfit may rise a little."""
        gradient = solver.data_gradient(point) + point.prior_gradient(weight)
        free = projected_gradient(point.x, gradient, point.objective.limits) != 0.0
        if not free.any():
            return None
        system = solver.linearize(point, weight, gradient, free, lowering)
        value, chi2 = point.value(weight), point.evaluation.chi2
        for _ in range(trials or self.max_trials):
            change = system.solve(damping)
            if change is not None:
                change = _within_limits(point, change)
                trial = _evaluate(point, change, solver.takes_over)
                if trial is not None:
                    gain = _gain(value - trial.value(weight), system.predicted_fall(change))
                    if gain > 0 or (lowering and trial.evaluation.chi2 < _MAX_RISE * chi2):
                        lower = max(0.2 * damping, _MIN_DAMPING) if gain > MIN_GAIN else damping
                        return _Step(trial, lower, gain)
            damping = 10.0 * max(damping, _MIN_RAISED_DAMPING)
            monitor.check_time()
        return None


def _within_limits(point: Point, step: Float[np.ndarray, " size"]) -> Float[np.ndarray, " size"]:
    """Cut a step to the bounds and to the largest for which the linearisation is meaningful."""
    cap, (low, high) = point.objective.max_step, point.objective.limits
    capped = np.clip(step, -cap, cap)
    end = point.x + capped
    return np.where((end < low) | (end > high), np.clip(end, low, high) - point.x, capped)


def _evaluate(point: Point, change: np.ndarray, takes_over: bool) -> Point | None:
    """Evaluate the end of a step; None where some press has no equilibrium."""
    objective = point.objective
    x = np.clip(point.x + change, *objective.limits)
    try:
        return objective.at(x, point, take_over=takes_over)
    except ConvergenceError:
        return None


def _gain(fall: float, predicted: float) -> float:
    """Fall of the objective over the fall of the quadratic model."""
    if predicted <= 0:  # the bounds turned the step uphill in the model
        return 1e-3 if fall > 0 else -1.0
    return float(fall / predicted)

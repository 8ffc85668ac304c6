"""The damped Newton loop of all inversions: Levenberg-Marquardt steps within bounds.

Each step solves (H + weight * prior + damping) step = -gradient over the parameters that are not
held at a bound, with H the Gauss-Newton or the true Hessian of the misfit. A `StepSolver` solves
the system: in parameter space, in data space, or by conjugate gradients. The damping grows where
the objective falls less than predicted, and shrinks where it falls as predicted.
"""

from abc import ABC, abstractmethod
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float

from tactorch.config import option
from tactorch.errors import ConvergenceError
from tactorch.inverse.fit.monitor import Monitor, StopReason
from tactorch.inverse.fit.objective import Objective, Point
from tactorch.inverse.fit.optimizers.base import Optimizer
from tactorch.inverse.fit.optimizers.schedule import MIN_GAIN, RegularizationSchedule
from tactorch.linalg import Solver, SymmetricPattern, analyse

# While the weight of the prior falls, the path follows a valley that is narrow where the noise is
# small: the misfit may rise by this factor, else the steps along it become tiny.
_MAX_RISE = 2.0
_CUT_FALL = 0.05  # relative fall of the objective by a step that was cut, below which it converges
Vector = Float[np.ndarray, " size"]
Mask = Bool[np.ndarray, " size"]


class Damping(NamedTuple):
    """Rule of the damping, which is relative to the diagonal of the Hessian.

    Directions that the data do not determine are the prior's; damping is for the nonlinearity
    alone, so it starts small, falls after every step of sufficient gain, and jumps where a step
    failed. The gain is the fall of the objective over the predicted one.

    Attributes:
        least: Smallest damping.
        raised: Smallest damping that is raised tenfold where a step failed.
        shrinkage: Factor after a step of sufficient gain.
        sufficient: Sufficient gain.
        accepted: Gain above which a step is accepted.
    """

    least: float = 1e-12
    raised: float = 1e-4
    shrinkage: float = 0.2
    sufficient: float = MIN_GAIN
    accepted: float = 0.0


class StepSolver(ABC):
    """Solves the linear systems of one run, and takes its steps."""

    damping = Damping()
    leaps = True  # the weight of the prior may fall by leaps
    takes_over = False  # a trial takes the factorisations of the present point over
    weight_rule = "discrepancy"  # chooses the weight of the prior
    trace: float | None = None  # of J^T J, where the sensitivity matrix J is not formed

    def data_gradient(self, point: Point) -> Vector:
        """Return the gradient of the misfit."""
        return point.jacobian.T @ point.evaluation.residuals

    @abstractmethod
    def linearize(
        self, point: Point, weight: float, gradient: Vector, free: Mask, lowering: bool
    ) -> None:
        """Set up the system at a point, with the objective's gradient, for the free parameters.

        While the weight is `lowering`, a step need not be accurate.
        """

    @abstractmethod
    def solve(self, damping: float) -> Vector | None:
        """Return the damped step, zero at held parameters; None where the system is singular."""

    @abstractmethod
    def predicted_fall(self, change: Vector) -> float:
        """Return the fall of the quadratic model along a change."""

    def trials(self, limit: int) -> int:
        """Return the limit of trial steps at the present point, where the settings have this one.

        Raises:
            StopOptimization: little is left to gain.
        """
        return limit

    def limited(self, point: Point, change: Vector) -> Vector:
        """Return a step cut to where the linearisation is meaningful, and to the bounds."""
        cap = point.objective.max_step
        return within_bounds(point, np.clip(change, -cap, cap))

    def moved(self, point: Point, change: Vector) -> Point:
        """Return the point after a step.

        Raises:
            ConvergenceError: a press has no equilibrium there.
        """
        x = np.clip(point.x + change, *point.objective.limits)
        return point.objective.at(x, point, take_over=self.takes_over)

    def state(self) -> dict[str, float]:
        """Return the numbers to resume from."""
        return {}

    def record(self) -> dict[str, float]:
        """Return figures for the record of the iteration."""
        return {}


class PriorSolver:
    """Solves with the prior's curvature plus a diagonal; its pattern is analysed once."""

    _pattern: SymmetricPattern | None = None
    _fixed: Mask | None = None

    def factor(self, prior: sp.csr_matrix, shift: Vector, fixed: Mask | None = None) -> bool:
        """Factor prior + positive diagonal with parameters held; return whether it is definite."""
        upper = sp.triu(prior + sp.diags(shift), format="csr")
        upper.sort_indices()
        rows, old = (upper.indptr, upper.indices), self._pattern
        if old is None or not all(map(np.array_equal, rows, (old.indptr, old.indices))):
            self._pattern = SymmetricPattern(*rows)
            self._solver: Solver = analyse(self._pattern)
        assert self._pattern is not None
        self._fixed = fixed
        values = upper.data if fixed is None else self._pattern.apply_dirichlet(upper.data, fixed)
        return self._solver.factor(values)

    def solve(self, rhs: Float[np.ndarray, "size *k"]) -> Float[np.ndarray, "size *k"]:
        """Solve; held parameters remain zero."""
        if self._fixed is None:
            return self._solver.solve(rhs)
        return np.where(self._fixed, 0.0, self._solver.solve(np.where(self._fixed, 0.0, rhs)))


class _Step(NamedTuple):
    point: Point
    damping: float  # the next one
    gain: float


@dataclass(frozen=True)
class DampedNewton(Optimizer):
    """Settings that the damped Newton methods have in common."""

    max_iterations: int = option(60, "Limit of accepted steps", gt=0)
    tolerance: float = option(1e-3, "Relative fall of the objective at which to stop", gt=0)
    damping: float = option(1e-6, "First damping, relative to the Hessian's diagonal", gt=0)
    max_trials: int = option(12, "Limit of trial steps at one iterate", gt=0)

    @abstractmethod
    def step_solver(self, point: Point, state: dict[str, float]) -> StepSolver:
        """Return the solver of a run that starts at a point or from a stored state."""

    def minimize(self, objective: Objective, start: Vector, monitor: Monitor) -> StopReason:
        point = objective.at(start)
        return self.descend(point, self.step_solver(point, monitor.state), monitor)

    def descend(self, point: Point, solver: StepSolver, monitor: Monitor) -> StopReason:
        """Minimise from a point by the steps of a solver; see `minimize`."""
        schedule = RegularizationSchedule.start(
            point, monitor.state, solver.weight_rule, solver.trace
        )
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
            step, final = None, schedule.final
            if schedule.leapt:
                step = self._step(point, solver, schedule.weight, damping, False, monitor, trials=1)
                if step is None or step.gain < MIN_GAIN:
                    schedule.retract()
                    step = None
            if step is None:
                lowering = not (final or schedule.held)
                step = self._step(point, solver, schedule.weight, damping, lowering, monitor)
            if step is None and schedule.held:
                step = self._step(point, solver, schedule.weight, damping, True, monitor)
            if step is None:
                return StopReason.NO_DESCENT
            weight, before = schedule.weight, point
            point, damping, gain = step
            fall = before.value(weight) - point.value(weight)
            if not _is_cut(before, point, fall / point.value(weight)):
                schedule.update(point, gain if solver.leaps else np.nan)
            converged = final and fall <= self.tolerance * point.value(weight)
            done = not schedule.retry(point, converged=converged) and converged
            report(weight, float(np.abs(point.x - before.x).max()))
            if done:
                return schedule.ended or StopReason.CONVERGED
        return StopReason.ITERATION_LIMIT

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
        rule = solver.damping
        gradient = solver.data_gradient(point) + point.prior_gradient(weight)
        free = projected_gradient(point.x, gradient, point.objective.limits) != 0.0
        if not free.any():
            return None
        solver.linearize(point, weight, gradient, free, lowering)
        value, chi2 = point.value(weight), point.evaluation.chi2
        for _ in range(trials or solver.trials(self.max_trials)):
            change, trial = solver.solve(damping), None
            if change is not None:
                change = solver.limited(point, change)
                with suppress(ConvergenceError):  # some press has no equilibrium there
                    trial = solver.moved(point, change)
            if change is not None and trial is not None:
                gain = _gain(value - trial.value(weight), solver.predicted_fall(change))
                if gain > rule.accepted or (lowering and trial.evaluation.chi2 < _MAX_RISE * chi2):
                    lower = max(rule.shrinkage * damping, rule.least)
                    return _Step(trial, lower if gain > rule.sufficient else damping, gain)
            damping = 10.0 * max(damping, rule.raised)
            monitor.check_time()
        return None


def _is_cut(before: Point, point: Point, fall: float) -> bool:
    """Whether limits of the step leave much to fall, for a map of strong contrast."""
    if not point.objective.strong_contrast or fall < _CUT_FALL:
        return False
    change = np.abs(point.x - before.x)
    return bool((change >= (1.0 - 1e-6) * point.objective.max_step).any())


def within_bounds(point: Point, change: Vector) -> Vector:
    """Return a step cut to the bounds of the parameters."""
    low, high = point.objective.limits
    end = point.x + change
    inside = (end >= low) & (end <= high)
    return np.where(inside, change, np.clip(end, low, high) - point.x)


def projected_gradient(x: Vector, gradient: Vector, limits: tuple[Any, Any]) -> Vector:
    """Return the gradient without the components that push against a bound."""
    low, high = limits
    blocked = ((x <= low) & (gradient > 0)) | ((x >= high) & (gradient < 0))
    return np.where(blocked, 0.0, gradient)


def _gain(fall: float, predicted: float) -> float:
    """Fall of the objective over the fall of the quadratic model."""
    if predicted <= 0:  # the bounds turned the step uphill in the model
        return 1e-3 if fall > 0 else -1.0
    return float(fall / predicted)

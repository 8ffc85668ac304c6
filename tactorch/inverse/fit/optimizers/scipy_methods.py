"""SciPy's bounded gradient methods: truncated Newton (the paper's) and L-BFGS-B."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize

from tactorch.config import option
from tactorch.errors import ConvergenceError
from tactorch.inverse.fields import Vector
from tactorch.inverse.fit.monitor import Monitor, StopReason
from tactorch.inverse.fit.objective import Objective, Point
from tactorch.inverse.fit.optimizers.base import Optimizer
from tactorch.inverse.fit.optimizers.schedule import RegularizationSchedule

_NO_EQUILIBRIUM = 1e3  # objective of a map without equilibrium, relative to the lowest
_TNC_REASONS = {
    0: StopReason.LOCAL_MINIMUM,
    1: StopReason.CONVERGED,
    2: StopReason.STALLED,
    3: StopReason.EVALUATION_LIMIT,
}


@dataclass(frozen=True)
class TNC(Optimizer):
    """The paper's truncated Newton with the adjoint gradient (Algorithm 1): SciPy's TNC.

    It does not choose the weight of a prior: one that is not given counts as zero. The paper calls
    evaluations "iterations"; those of a resumed inversion include its earlier ones.
    """

    max_evaluations: int = option(500, "Limit of solves of all presses", gt=0)
    ftol: float = option(1e-12, "Change of the objective at which to stop", gt=0)
    gtol: float = option(1e-10, "Projected gradient at which to stop", gt=0)

    def minimize(self, objective: Objective, start: Vector, monitor: Monitor) -> StopReason:
        remaining = self.max_evaluations - monitor.evaluations
        if remaining <= 0:
            return StopReason.EVALUATION_LIMIT
        run = _BoundedRun(objective.at(start), monitor, objective.weight or 0.0)
        result = run.run("TNC", {"maxfun": remaining, "ftol": self.ftol, "gtol": self.gtol})
        return _TNC_REASONS.get(int(result.status), StopReason.LINE_SEARCH_FAILED)


@dataclass(frozen=True)
class LBFGS(Optimizer):
    """SciPy's L-BFGS-B (Byrd, Lu, Nocedal and Zhu, 1995), the prior's weight lowered in stages."""

    max_iterations: int = option(500, "Limit of iterations over all stages", gt=0)
    stage_iterations: int = option(40, "Iterations at one weight of the prior", gt=0)
    memory: int = option(30, "Number of gradient pairs", gt=0)
    ftol: float = option(1e-9, "Relative change of the objective that ends a stage", gt=0)

    def minimize(self, objective: Objective, start: Vector, monitor: Monitor) -> StopReason:
        point = objective.at(start)
        schedule = RegularizationSchedule.start(point, monitor.state)
        while schedule.ended is None:
            monitor.state = schedule.state()
            remaining = self.max_iterations - monitor.iteration
            if remaining <= 0:
                return StopReason.ITERATION_LIMIT
            run = _BoundedRun(point, monitor, schedule.weight)
            stage = remaining if schedule.fixed else min(remaining, self.stage_iterations)
            options = {"maxiter": stage, "maxcor": self.memory, "ftol": self.ftol, "gtol": 1e-12}
            result = run.run("L-BFGS-B", options)
            point = run.point
            if schedule.fixed:
                if result.nit >= remaining or result.status == 1:
                    return StopReason.ITERATION_LIMIT
                return StopReason.CONVERGED if result.success else StopReason.LINE_SEARCH_FAILED
            schedule.lower(point.evaluation.chi2)
        monitor.state = schedule.state()
        return schedule.ended


class _BoundedRun:
    """One run of `scipy.optimize.minimize` with the adjoint gradient.

    A map at which some press has no equilibrium gets a large value, so that line searches turn
    back. The lowest point is the monitor's best, however the run ends.
    """

    def __init__(self, point: Point, monitor: Monitor, weight: float) -> None:
        self.point = point  # the lowest so far
        self._latest, self._monitor, self._weight = point, monitor, weight

    def run(self, method: str, options: dict[str, Any]) -> Any:
        limits, start = self.point.objective.limits, self.point.x
        if not self._monitor.history:
            self._report()
        try:
            return minimize(
                self._value,
                start,
                jac=True,
                method=method,
                bounds=np.column_stack(limits),
                callback=self._report,
                options=options,
            )
        finally:
            if self.point is not self._monitor.point and self.point.x is not start:
                self._keep()

    def _value(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        near = self._latest
        if np.array_equal(near.x, x):
            return near.value(self._weight), self._gradient(near)
        self._monitor.check_time()
        lowest = self.point.value(self._weight)
        try:
            point = near.objective.at(x.copy(), near)
            gradient = self._gradient(point)
        except ConvergenceError:
            return _NO_EQUILIBRIUM * max(lowest, 1.0), self._gradient(near)
        self._latest = point
        value = point.value(self._weight)
        if value < lowest:
            self.point = point
        return value, gradient

    def _gradient(self, point: Point) -> np.ndarray:
        return point.data_gradient + point.prior_gradient(self._weight)

    def _report(self, _: Any = None) -> None:
        """Report the lowest point, once per iteration."""
        self._keep()
        self._monitor.check_time()

    def _keep(self) -> None:
        before, point = self._monitor.best, self.point
        step = 0.0 if before is None else float(np.abs(point.x - before).max())
        value = point.value(self._weight)
        self._monitor.keep(point, objective=value, weight=self._weight, step=step)

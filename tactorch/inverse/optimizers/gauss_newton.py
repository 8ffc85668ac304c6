"""Gauss-Newton with Levenberg-Marquardt damping, within bounds.

Each step solves (J^T J + weight * prior + damping) step = -gradient over the parameters that are
not held at a bound; J = d residuals / d x is the full sensitivity matrix (eq. 13). Damping grows
when the objective does not fall as foretold, and shrinks when it does.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from tactorch.config import option
from tactorch.errors import ConvergenceError
from tactorch.inverse.monitor import Monitor
from tactorch.inverse.objective import Objective, Point
from tactorch.inverse.optimizers.base import Optimizer, projected_gradient
from tactorch.inverse.optimizers.normal import data_space_step, parameter_space_step
from tactorch.inverse.optimizers.weight import POOR, RegularizationSchedule

# While the weight of the prior falls, the path follows a valley that is narrow where the noise is
# small: the data misfit may rise a little on the way, else the steps along it become tiny.
_LEEWAY = 2.0
# The prior bears what the data do not see; damping is for the nonlinearity alone, so it starts
# small, falls after every step that was foretold at all, and jumps where a step failed.
_LEAST, _LEAST_RAISED = 1e-12, 1e-4


@dataclass(frozen=True)
class GaussNewton(Optimizer):
    """Gauss-Newton with Levenberg-Marquardt damping on the full sensitivity matrix.

    Attributes:
        max_iterations: Limit of accepted steps.
        tolerance: Relative fall of the objective, at a final weight, at which to stop.
        damping: First damping, relative to the mean diagonal of J^T J.
        max_trials: Limit of trial steps at one iterate.
        space: Space of the linear system: "data" (p x p), "parameter" (m x m), or "auto" by size.
        weight_rule: Rule that chooses the weight of a prior whose weight is not given.
    """

    max_iterations: int = option(60, "Limit of accepted steps", gt=0)
    tolerance: float = option(1e-3, "Relative fall of the objective at which to stop", gt=0)
    damping: float = option(1e-6, "First damping, relative to the mean diagonal of J^T J", gt=0)
    max_trials: int = option(12, "Limit of trial steps at one iterate", gt=0)
    space: Literal["auto", "data", "parameter"] = option("auto", "Space of the linear system")
    weight_rule: Literal["discrepancy", "l_curve", "gcv"] = option(
        "discrepancy", "Rule that chooses the weight of the prior"
    )

    def minimize(
        self, objective: Objective, start: Float[np.ndarray, " m"], monitor: Monitor
    ) -> str:
        """See `Optimizer.minimize`."""
        point = objective.at(start)
        cooling = RegularizationSchedule.start(point, monitor.state, self.weight_rule)
        damping = monitor.state.get("damping", self.damping)
        if not monitor.history:
            self._report(monitor, point, cooling, cooling.weight, damping, 0.0)
        while monitor.iteration < self.max_iterations:
            settled = cooling.fixed or bool(cooling.ended)
            trial = self._advance(point, cooling, damping, monitor)
            if trial is None:
                return "no step lowers the objective any more"
            after, damping, gain = trial
            weight = cooling.weight
            step = float(np.abs(after.x - point.x).max())
            fall = point.value(weight) - after.value(weight)
            point = after
            cooling.follow(point, gain)
            still = settled and fall <= self.tolerance * point.value(weight)
            done = not cooling.retry(point, converged=still) and still
            self._report(monitor, point, cooling, weight, damping, step)
            if done:
                return cooling.ended or "the objective no longer falls"
        return "iteration limit reached"

    @staticmethod
    def _report(
        monitor: Monitor,
        point: Point,
        cooling: RegularizationSchedule,
        weight: float,
        damping: float,
        step: float,
    ) -> None:
        """Report a step made at `weight`; what the next one needs goes into the state."""
        monitor.state = {**cooling.state(), "damping": damping}
        monitor.accept(
            point, objective=point.value(weight), weight=weight, step=step, damping=damping
        )

    def _advance(
        self, point: Point, cooling: RegularizationSchedule, damping: float, monitor: Monitor
    ) -> tuple[Point, float, float] | None:
        """Make a step; see `_step`. A leap of the weight that leads nowhere is taken back."""
        if cooling.leapt:
            trial = self._step(point, cooling.weight, damping, False, monitor, trials=1)
            if trial is not None and trial[2] >= POOR:
                return trial
            cooling.retract()
        leeway = not (cooling.fixed or cooling.ended or cooling.held)
        trial = self._step(point, cooling.weight, damping, leeway, monitor)
        if trial is None and cooling.held:
            trial = self._step(point, cooling.weight, damping, True, monitor)
        return trial

    def _step(
        self,
        point: Point,
        weight: float,
        damping: float,
        leeway: bool,
        monitor: Monitor,
        trials: int | None = None,
    ) -> tuple[Point, float, float] | None:
        """Try steps, damping more each time, until one is good enough; its damping and its gain."""
        limits = point.objective.limits
        gradient = point.jacobian.T @ point.evaluation.residuals + point.prior_gradient(weight)
        free = projected_gradient(point.x, gradient, limits) != 0.0
        if not free.any():
            return None
        diagonal = np.einsum("ij,ij->j", point.jacobian, point.jacobian)
        diagonal += point.prior_curvature(weight).diagonal()
        for _ in range(trials or self.max_trials):
            shift = damping * diagonal[free]
            change = self._solve(point, gradient, free, weight, shift)
            if change is not None:
                trial = self._try(point, change)
                if trial is not None:
                    ratio = self._gain(point, trial, gradient, weight)
                    lead = trial.evaluation.chi2 / point.evaluation.chi2
                    if ratio > 0 or (leeway and lead < _LEEWAY):
                        return trial, _next_damping(damping, ratio), ratio
            damping = 10.0 * max(damping, _LEAST_RAISED)
            monitor.check_time()
        return None

    def _solve(
        self, point: Point, gradient: np.ndarray, free: np.ndarray, weight: float, shift: np.ndarray
    ) -> np.ndarray | None:
        everything = bool(free.all())
        jacobian = point.jacobian if everything else point.jacobian[:, free]
        prior = point.prior_curvature(weight)
        prior = prior if everything else prior[free][:, free]
        in_data = self.space == "data" or (self.space == "auto" and _data_is_cheaper(jacobian))
        solve = data_space_step if in_data else parameter_space_step
        step = solve(jacobian, gradient[free], prior, shift)
        if step is None or not np.all(np.isfinite(step)):
            return None
        change = np.zeros_like(gradient)
        change[free] = step
        return change

    @staticmethod
    def _try(point: Point, change: np.ndarray) -> Point | None:
        """Evaluate a step cut to the bounds; None where some press finds no equilibrium."""
        objective = point.objective
        cap = objective.max_step
        x = np.clip(point.x + np.clip(change, -cap, cap), *objective.limits)
        try:
            return objective.at(x, point)
        except ConvergenceError:
            return None

    @staticmethod
    def _gain(point: Point, trial: Point, gradient: np.ndarray, weight: float) -> float:
        """Fall of the objective over the fall that the quadratic model foretells."""
        change = trial.x - point.x
        image = point.jacobian @ change
        curved = image @ image + change @ (point.prior_curvature(weight) @ change)
        foretold = -(gradient @ change + 0.5 * curved)
        fallen = point.value(weight) - trial.value(weight)
        if foretold <= 0:  # the bounds turned the step uphill in the model
            return 1e-3 if fallen > 0 else -1.0
        return float(fallen / foretold)


def _data_is_cheaper(jacobian: np.ndarray) -> bool:
    """Fewer data than unknowns by enough to pay for the sparse solves."""
    data, unknowns = jacobian.shape
    return data < 0.8 * unknowns


def _next_damping(damping: float, ratio: float) -> float:
    return max(0.2 * damping, _LEAST) if ratio > POOR else damping

"""Newton's method with each step by conjugate gradients: no sensitivity matrix is ever formed.

A product with J^T J costs two solves a press with factorisations that stand, so memory grows as the
factors do, not as data times elements. The system is preconditioned by the prior, and the step need
only be as good as the model is. Damping, bounds and the weight of the prior are those of
`gauss_newton`, but that the weight never leaps. `hessian="true"` adds the second derivatives that
Gauss-Newton leaves out.
"""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Float

from tactorch.config import option
from tactorch.errors import ConfigError, ConvergenceError
from tactorch.inverse.monitor import Monitor
from tactorch.inverse.objective import Objective, Point
from tactorch.inverse.optimizers.base import Optimizer, projected_gradient
from tactorch.inverse.optimizers.hessian import SecondOrder
from tactorch.inverse.optimizers.preconditioner import PriorSolver
from tactorch.inverse.optimizers.probing import data_trace, start_cooling
from tactorch.inverse.optimizers.weight import RegularizationSchedule
from tactorch.linalg import conjugate_gradients

_POOR, _LEEWAY = 0.1, 2.0  # as in `gauss_newton`
_LEAST, _LEAST_RAISED = 1e-12, 1e-4
# What the prior does not see (a uniform change) is held by this share of the data's mean diagonal.
_BASE = 1e-3
# While the weight of the prior falls, the next step mends what this one leaves.
_LOOSER = 3.0


@dataclass(frozen=True, eq=False)
class _Move:
    """A step cut to the bounds, and the fall of the objective that the model foretells."""

    change: Float[np.ndarray, " size"]
    foretold: float
    iterations: int


@dataclass(frozen=True)
class NewtonCG(Optimizer):
    """Newton's method by conjugate gradients, without the sensitivity matrix: for large meshes.

    Attributes:
        max_iterations: Limit of accepted steps.
        tolerance: Relative fall of the objective, at a final weight, at which to stop.
        damping: First damping, relative to the mean diagonal of J^T J.
        max_trials: Limit of trial steps at one iterate.
        cg_iterations: Limit of conjugate-gradient iterations in one step.
        forcing: Relative residual of a step's system at a final weight far from the solution;
            near it, smaller, by choice 2 of Eisenstat and Walker (1996).
        hessian: "gauss_newton", or "true" with the second derivatives.
    """

    max_iterations: int = option(60, "Limit of accepted steps", gt=0)
    tolerance: float = option(1e-3, "Relative fall of the objective at which to stop", gt=0)
    damping: float = option(1e-6, "First damping, relative to the mean diagonal of J^T J", gt=0)
    max_trials: int = option(12, "Limit of trial steps at one iterate", gt=0)
    cg_iterations: int = option(200, "Limit of conjugate-gradient iterations in one step", gt=0)
    forcing: float = option(0.03, "Relative residual of a step's linear system", gt=0, lt=1)
    hessian: Literal["gauss_newton", "true"] = option(
        "gauss_newton", "Hessian: without or with the second derivatives"
    )

    def minimize(
        self, objective: Objective, start: Float[np.ndarray, " m"], monitor: Monitor
    ) -> str:
        """See `Optimizer.minimize`."""
        if self.hessian == "true" and objective.nuisance.size:
            raise ConfigError(
                "optimizer.hessian=true does not know nuisance parameters; use gauss_newton."
            )
        point = objective.at(start)
        state = dict(monitor.state)
        if "data_trace" not in state:
            state["data_trace"] = data_trace(point)
        run = _Run(self, monitor, state["data_trace"])
        cooling = start_cooling(point, monitor.state, run.trace)
        run.damping = state.get("damping", self.damping)
        run.gradient_size = state.get("gradient_size", np.inf)
        if not monitor.history:
            run.report(point, cooling, cooling.weight, 0.0)
        while monitor.iteration < self.max_iterations:
            weight = cooling.weight
            settled = cooling.fixed or bool(cooling.ended)
            after = run.step(point, weight, not settled)
            if after is None:
                return "no step lowers the objective any more"
            step = float(np.abs(after.x - point.x).max())
            fall = point.value(weight) - after.value(weight)
            point = after
            cooling.lower(point.evaluation.chi2)
            still = settled and fall <= self.tolerance * point.value(weight)
            done = not cooling.retry(point, converged=still) and still
            run.report(point, cooling, weight, step)
            if done:
                return cooling.ended or "the objective no longer falls"
        return "iteration limit reached"


@dataclass(eq=False)
class _Run:
    """One run: the settings, and what changes on the way."""

    settings: NewtonCG
    monitor: Monitor
    trace: float
    damping: float = 0.0
    gradient_size: float = np.inf
    products: int = 0
    prior: PriorSolver = field(default_factory=PriorSolver)

    def report(
        self, point: Point, cooling: RegularizationSchedule, weight: float, step: float
    ) -> None:
        """Report a step made at `weight`; what the next one needs goes into the state."""
        self.monitor.state = {
            **cooling.state(),
            "damping": self.damping,
            "data_trace": self.trace,
            "gradient_size": self.gradient_size,
        }
        self.monitor.accept(
            point, objective=point.value(weight), weight=weight, step=step, damping=self.damping,
            products=self.products,
        )  # fmt: skip
        self.products = 0

    def step(self, point: Point, weight: float, cooling: bool) -> Point | None:
        """Try steps, damping more each time, until one is good enough."""
        gradient = point.data_gradient + point.prior_gradient(weight)
        free = projected_gradient(point.x, gradient, point.objective.limits) != 0.0
        if not free.any():
            return None
        accuracy = self._accuracy(float(np.linalg.norm(gradient[free])), cooling)
        value, chi2 = point.value(weight), point.evaluation.chi2
        for _ in range(self.settings.max_trials):
            move = self._move(point, np.where(free, gradient, 0.0), free, weight, accuracy)
            trial = None if move is None else _try(point, move.change)
            if move is not None and trial is not None:
                self.products += move.iterations
                ratio = _gain(value - trial.value(weight), move.foretold)
                if ratio > 0 or (cooling and trial.evaluation.chi2 < _LEEWAY * chi2):
                    if ratio > _POOR:
                        self.damping = max(0.2 * self.damping, _LEAST)
                    return trial
            self.damping = 10.0 * max(self.damping, _LEAST_RAISED)
            self.monitor.check_time()
        return None

    def _accuracy(self, size: float, cooling: bool) -> float:
        """Eisenstat and Walker's second choice, from the sizes of this gradient and the last."""
        last, self.gradient_size = self.gradient_size, size
        forcing = self.settings.forcing
        if cooling:
            return min(_LOOSER * forcing, 0.5)
        return float(np.clip(0.9 * (size / last) ** 2, 1e-3 * forcing, forcing))

    def _move(
        self, point: Point, gradient: np.ndarray, free: np.ndarray, weight: float, accuracy: float
    ) -> _Move | None:
        """Solve for a step and cut it to the bounds; None where the prior breaks down."""
        prior = point.prior_curvature(weight)
        mean = self.trace / len(gradient)
        shift = self.damping * (mean + prior.diagonal())
        base = shift + _BASE * mean + np.finfo(float).tiny
        if not self.prior.factor(prior, base, ~free):
            return None
        second = SecondOrder(point) if self.settings.hessian == "true" else None

        def curved(change: np.ndarray) -> np.ndarray:
            image = point.transpose_times(point.jacobian_times(change)) + prior @ change
            return image if second is None else image + second.product(change)

        def damped(change: np.ndarray) -> np.ndarray:
            return np.where(free, curved(change) + shift * change, 0.0)

        solved = conjugate_gradients(
            damped, self.prior.solve, -gradient, rtol=accuracy,
            max_iterations=self.settings.cg_iterations, preconditioned_norm=True,
            orthogonalize=True,
        )  # fmt: skip
        change = _cut(point, solved.solution)
        if not np.all(np.isfinite(change)):
            return None
        as_solved = np.array_equal(change, solved.solution)
        image = solved.image - shift * change if as_solved else curved(change)
        return _Move(change, -float(gradient @ change + 0.5 * change @ image), solved.iterations)


def _cut(point: Point, step: np.ndarray) -> np.ndarray:
    """Cut a step to the bounds and to the largest that the linearisation bears."""
    cap, (low, high) = point.objective.max_step, point.objective.limits
    capped = np.clip(step, -cap, cap)
    return np.where(
        (point.x + capped < low) | (point.x + capped > high),
        np.clip(point.x + capped, low, high) - point.x,
        capped,
    )


def _try(point: Point, change: np.ndarray) -> Point | None:
    """Evaluate a step; None where some press finds no equilibrium."""
    objective = point.objective
    x = np.clip(point.x + change, *objective.limits)
    try:
        return objective.at(x, point, take_over=True)
    except ConvergenceError:
        return None


def _gain(fallen: float, foretold: float) -> float:
    """Fall of the objective over the fall that the quadratic model foretells."""
    if foretold <= 0:  # the bounds turned the step uphill in the model
        return 1e-3 if fallen > 0 else -1.0
    return fallen / foretold

"""Newton's method with conjugate gradients, which does not form the sensitivity matrix.

A product with J^T J takes two solves per press with existing factorisations, so memory grows as
the factors do, not as data times elements. The prior preconditions the system, and each step is
only as accurate as the quadratic model.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from tactorch.config import option
from tactorch.errors import ConfigError
from tactorch.inverse.fit.objective import Point
from tactorch.inverse.fit.optimizers.damped import (
    DampedNewton,
    Mask,
    PriorSolver,
    StepSolver,
    Vector,
)
from tactorch.linalg import conjugate_gradients

# Shift of the preconditioner where the prior is zero (a uniform change), relative to the mean
# diagonal of J^T J.
_BASE_SHIFT = 1e-3
# Factor of the forcing while the weight of the prior falls: the next step corrects the remainder.
_LOOSENING = 3.0
_PROBES, _SEED = 8, 20240607


@dataclass(frozen=True)
class NewtonCG(DampedNewton):
    """Newton's method by conjugate gradients, without the sensitivity matrix: for large meshes.

    `forcing` applies at a final weight far from the solution; near it, it is smaller, by choice 2
    of Eisenstat and Walker (1996).
    """

    cg_iterations: int = option(200, "Limit of conjugate-gradient iterations in one step", gt=0)
    forcing: float = option(0.03, "Relative residual of a step's linear system", gt=0, lt=1)
    hessian: Literal["gauss_newton", "true"] = option(
        "gauss_newton", "Hessian: without or with the second derivatives"
    )

    def step_solver(self, point: Point, state: dict[str, float]) -> StepSolver:
        if self.hessian == "true" and point.objective.nuisance.size:
            raise ConfigError(
                "optimizer.hessian=true does not support nuisance parameters; use gauss_newton."
            )
        return _CGSteps(self, point, state)


class _CGSteps(StepSolver):
    leaps = False
    takes_over = True
    trace: float

    def __init__(self, settings: NewtonCG, point: Point, state: dict[str, float]) -> None:
        self._settings, self._prior_solver = settings, PriorSolver()
        self.trace = state["data_trace"] if "data_trace" in state else data_trace(point)
        self._gradient_size = state.get("gradient_size", np.inf)
        self._products = 0

    def data_gradient(self, point: Point) -> Vector:
        return point.data_gradient

    def linearize(
        self, point: Point, weight: float, gradient: Vector, free: Mask, lowering: bool
    ) -> None:
        # Eisenstat and Walker's second choice, from the sizes of this gradient and the last.
        last, forcing = self._gradient_size, self._settings.forcing
        self._gradient_size = size = float(np.linalg.norm(gradient[free]))
        if lowering:
            self._rtol = min(_LOOSENING * forcing, 0.5)
        else:
            self._rtol = float(np.clip(0.9 * (size / last) ** 2, 1e-3 * forcing, forcing))
        self._point, self._prior = point, point.prior_curvature(weight)
        self._gradient, self._free = np.where(free, gradient, 0.0), free

    def _product(self, change: np.ndarray) -> np.ndarray:
        point = self._point
        image = point.transpose_times(point.jacobian_times(change)) + self._prior @ change
        if self._settings.hessian == "true":
            image = image + point.second_order_times(change)
        return image

    def solve(self, damping: float) -> Vector | None:
        mean, free = self.trace / len(self._gradient), self._free
        shift = self._shift = damping * (mean + self._prior.diagonal())
        base = shift + _BASE_SHIFT * mean + np.finfo(float).tiny
        if not self._prior_solver.factor(self._prior, base, ~free):
            return None
        self._solved = conjugate_gradients(
            lambda change: np.where(free, self._product(change) + shift * change, 0.0),
            self._prior_solver.solve,
            -self._gradient,
            rtol=self._rtol,
            max_iterations=self._settings.cg_iterations,
            preconditioned_norm=True,
            orthogonalize=True,
        )
        self._products += self._solved.iterations
        step = self._solved.solution
        return step if np.all(np.isfinite(step)) else None

    def predicted_fall(self, change: Vector) -> float:
        uncut = np.array_equal(change, self._solved.solution)
        image = self._solved.image - self._shift * change if uncut else self._product(change)
        return -float(self._gradient @ change + 0.5 * change @ image)

    def state(self) -> dict[str, float]:
        return {"data_trace": self.trace, "gradient_size": self._gradient_size}

    def record(self) -> dict[str, float]:
        products, self._products = self._products, 0
        return {"products": products}


def data_trace(point: Point, probes: int = _PROBES) -> float:
    """Estimate the trace of J^T J by one solve per press and probe.

    For random signs s of the data, the mean of |J^T s|^2 is the trace of J J^T (Hutchinson, 1990).
    The signs are the same in every run, so that a resumed run repeats the uninterrupted one.
    """
    rng = np.random.default_rng(_SEED)
    size = len(point.evaluation.residuals)
    images = (point.transpose_times(rng.choice((-1.0, 1.0), size)) for _ in range(probes))
    return float(np.mean([image @ image for image in images]))

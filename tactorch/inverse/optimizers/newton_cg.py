"""Newton's method with conjugate gradients, which does not form the sensitivity matrix.

A product with J^T J takes two solves per press with existing factorisations, so memory grows as
the factors do, not as data times elements. The prior preconditions the system, and each step is
only as accurate as the quadratic model.
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float

from tactorch.config import option
from tactorch.errors import ConfigError
from tactorch.inverse.objective import Point
from tactorch.inverse.optimizers.damped import DampedNewton, LinearSystem, StepSolver
from tactorch.inverse.optimizers.schedule import RegularizationSchedule
from tactorch.linalg import Solver, SymmetricPattern, analyse, conjugate_gradients
from tactorch.linalg.conjugate_gradients import CGResult

# Shift of the preconditioner where the prior is zero (a uniform change), relative to the mean
# diagonal of J^T J.
_BASE_SHIFT = 1e-3
# Factor of the forcing while the weight of the prior falls: the next step corrects the remainder.
_LOOSENING = 3.0
_PROBES, _SEED = 8, 20240607


@dataclass(frozen=True)
class NewtonCG(DampedNewton):
    """Newton's method by conjugate gradients, without the sensitivity matrix: for large meshes.

    Attributes:
        max_iterations: Limit of accepted steps.
        tolerance: Relative fall of the objective, at a final weight, at which to stop.
        damping: First damping, relative to the diagonal of the Hessian.
        max_trials: Limit of trial steps at one iterate.
        cg_iterations: Limit of conjugate-gradient iterations in one step.
        forcing: Relative residual of a step's system at a final weight far from the solution;
            near it, smaller, by choice 2 of Eisenstat and Walker (1996).
        hessian: "gauss_newton", or "true" with the second derivatives of the predictions.
    """

    cg_iterations: int = option(200, "Limit of conjugate-gradient iterations in one step", gt=0)
    forcing: float = option(0.03, "Relative residual of a step's linear system", gt=0, lt=1)
    hessian: Literal["gauss_newton", "true"] = option(
        "gauss_newton", "Hessian: without or with the second derivatives"
    )

    def step_solver(self, point: Point, state: dict[str, float]) -> StepSolver:
        """Return the solver of a run.

        Raises:
            ConfigError: nuisance parameters are estimated, which the true Hessian excludes.
        """
        if self.hessian == "true" and point.objective.nuisance.size:
            raise ConfigError(
                "optimizer.hessian=true does not support nuisance parameters; use gauss_newton."
            )
        trace = state["data_trace"] if "data_trace" in state else data_trace(point)
        return _CGSteps(self, trace, state.get("gradient_size", np.inf))


@dataclass(eq=False)
class _CGSteps(StepSolver):
    leaps = False
    takes_over = True

    settings: NewtonCG
    trace: float
    gradient_size: float
    products: int = 0
    prior: "PriorSolver" = field(default_factory=lambda: PriorSolver())

    def schedule(self, point: Point, state: dict[str, float]) -> RegularizationSchedule:
        return RegularizationSchedule.start(point, state, trace=self.trace)

    def data_gradient(self, point: Point) -> Float[np.ndarray, " size"]:
        return point.data_gradient

    def linearize(
        self,
        point: Point,
        weight: float,
        gradient: Float[np.ndarray, " size"],
        free: Bool[np.ndarray, " size"],
        lowering: bool,
    ) -> LinearSystem:
        rtol = self._accuracy(float(np.linalg.norm(gradient[free])), lowering)
        prior = point.prior_curvature(weight)
        return _CGSystem(self, point, prior, np.where(free, gradient, 0.0), free, rtol)

    def _accuracy(self, size: float, lowering: bool) -> float:
        """Eisenstat and Walker's second choice, from the sizes of this gradient and the last."""
        last, self.gradient_size = self.gradient_size, size
        forcing = self.settings.forcing
        if lowering:
            return min(_LOOSENING * forcing, 0.5)
        return float(np.clip(0.9 * (size / last) ** 2, 1e-3 * forcing, forcing))

    def state(self) -> dict[str, float]:
        return {"data_trace": self.trace, "gradient_size": self.gradient_size}

    def record(self) -> dict[str, float]:
        products, self.products = self.products, 0
        return {"products": products}


@dataclass(eq=False)
class _CGSystem:
    steps: _CGSteps
    point: Point
    prior: sp.csr_matrix
    gradient: Float[np.ndarray, " size"]
    free: Bool[np.ndarray, " size"]
    rtol: float
    _shift: np.ndarray = field(init=False)
    _solved: CGResult = field(init=False)

    @cached_property
    def _second_order(self) -> "SecondOrder | None":
        return SecondOrder(self.point) if self.steps.settings.hessian == "true" else None

    def _product(self, change: np.ndarray) -> np.ndarray:
        image = self.point.transpose_times(self.point.jacobian_times(change)) + self.prior @ change
        return image if self._second_order is None else image + self._second_order.product(change)

    def solve(self, damping: float) -> Float[np.ndarray, " size"] | None:
        mean = self.steps.trace / len(self.gradient)
        shift = self._shift = damping * (mean + self.prior.diagonal())
        base = shift + _BASE_SHIFT * mean + np.finfo(float).tiny
        if not self.steps.prior.factor(self.prior, base, ~self.free):
            return None

        def damped(change: np.ndarray) -> np.ndarray:
            return np.where(self.free, self._product(change) + shift * change, 0.0)

        self._solved = conjugate_gradients(
            damped,
            self.steps.prior.solve,
            -self.gradient,
            rtol=self.rtol,
            max_iterations=self.steps.settings.cg_iterations,
            preconditioned_norm=True,
            orthogonalize=True,
        )
        self.steps.products += self._solved.iterations
        step: np.ndarray = self._solved.solution
        return step if np.all(np.isfinite(step)) else None

    def predicted_fall(self, change: Float[np.ndarray, " size"]) -> float:
        uncut = np.array_equal(change, self._solved.solution)
        image = self._solved.image - self._shift * change if uncut else self._product(change)
        return -float(self.gradient @ change + 0.5 * change @ image)


@dataclass(frozen=True, eq=False)
class SecondOrder:
    """The part of the misfit's Hessian that Gauss-Newton omits, without nuisance parameters.

    A product takes one solve per press more than the two of Gauss-Newton; see
    `tactorch.fem.Linearization.second_order`.

    Attributes:
        point: Point of the objective.
    """

    point: Point

    @cached_property
    def _slope(self) -> Float[np.ndarray, " m"]:
        return self.point.objective.parameterization.slope(self.point.x)

    @cached_property
    def _curvature(self) -> Float[np.ndarray, " m"]:
        """Gradient by the moduli times d^2 youngs / d x^2."""
        second = self.point.objective.parameterization.second_derivative(self.point.x)
        return self.point.data_gradient / self._slope * second

    @cached_property
    def _adjoints(self) -> list[Float[np.ndarray, "nodes 3"]]:
        return self.point.evaluation.adjoints(self.point.evaluation.residuals)

    def product(self, change: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Return the second-order part times a change of x."""
        sensitivities = self.point.evaluation.sensitivities
        parts = [
            sensitivity.linearization.second_order(adjoint, self._slope * change)
            for sensitivity, adjoint in zip(sensitivities, self._adjoints, strict=True)
        ]
        return self._slope * np.sum(parts, axis=0) + self._curvature * change


class PriorSolver:
    """Solves with the prior's curvature plus a diagonal; its pattern is analysed once."""

    def __init__(self) -> None:
        """Start without a pattern; the first `factor` analyses it."""
        self._indices: tuple[np.ndarray, np.ndarray] | None = None
        self._fixed = np.zeros(0, dtype=bool)

    def factor(
        self,
        prior: sp.csr_matrix,
        shift: Float[np.ndarray, " size"],
        fixed: Bool[np.ndarray, " size"],
    ) -> bool:
        """Factor prior + diagonal with parameters held; return whether it is definite."""
        prior = prior.tocsr()
        known = self._indices
        if known is None or not (
            np.array_equal(known[0], prior.indptr) and np.array_equal(known[1], prior.indices)
        ):
            self._analyse(prior)
        values = np.zeros(self._pattern.nnz)
        np.add.at(values, self._slots, prior.data[self._upper])
        values[self._pattern.diagonal] += shift
        self._fixed = fixed
        return self._solver.factor(self._pattern.apply_dirichlet(values, fixed))

    def _analyse(self, prior: sp.csr_matrix) -> None:
        self._indices = prior.indptr.copy(), prior.indices.copy()
        coo = prior.tocoo()
        rows, cols = coo.row.astype(np.int64), coo.col.astype(np.int64)
        self._upper = rows <= cols
        self._pattern = SymmetricPattern.from_pairs(prior.shape[0], rows, cols)
        self._slots = self._pattern.slots(rows[self._upper], cols[self._upper])
        self._solver: Solver = analyse(self._pattern, "auto")

    def solve(self, rhs: Float[np.ndarray, " size"]) -> Float[np.ndarray, " size"]:
        """Solve; held parameters remain zero."""
        out = self._solver.solve(np.where(self._fixed, 0.0, rhs))
        return np.where(self._fixed, 0.0, out)


def data_trace(point: Point, probes: int = _PROBES) -> float:
    """Estimate the trace of J^T J by one solve per press and probe.

    For random signs s of the data, the mean of |J^T s|^2 is the trace of J J^T (Hutchinson, 1990).
    The signs are the same in every run, so that a resumed run repeats the uninterrupted one.
    """
    rng = np.random.default_rng(_SEED)
    size = len(point.evaluation.residuals)
    images = (point.transpose_times(rng.choice((-1.0, 1.0), size)) for _ in range(probes))
    return float(np.mean([image @ image for image in images]))

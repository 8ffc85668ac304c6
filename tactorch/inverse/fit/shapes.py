"""The fit of a field of shapes to presses, its posterior and its evidence.

The fit minimises half the sum of squared residuals plus that of the coefficients in standard
deviations of their prior, by damped Gauss-Newton steps (Levenberg-Marquardt). The posterior is
normal (Laplace approximation), and so is the evidence: log Z = -(|r|^2 + |z|^2 + log det(H) + log
det(C)) / 2 with H = J^T J + 1 and the covariance C of the data (MacKay, Information Theory,
Inference, and Learning Algorithms, 2003, chapter 28), up to a constant of the data.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float
from scipy.linalg import null_space

from tactorch.inverse.fields import FieldPoint, ModulusField, ShapeField, Sites, Vector
from tactorch.inverse.fit.monitor import Monitor, StopOptimization, StopReason
from tactorch.inverse.fit.objective import Objective, Point
from tactorch.inverse.fit.optimizers.damped import (
    Damping,
    Mask,
    StepSolver,
    projected_gradient,
    within_bounds,
)
from tactorch.inverse.fit.optimizers.gauss_newton import GaussNewton
from tactorch.inverse.forward.problem import Evaluation, InverseProblem

# Of a coefficient, in standard deviations of its prior, which excludes 6e-5 beyond four.
_MAX_STEP, _MAX_Z = 0.5, 4.0
_MAX_TRIALS = 8  # of growing damping, up to 1e5, where a step is negligible
# Predicted fall, that of one standard deviation, below which errors of derivatives may hinder it.
_ROUND_OFF = 0.5
_NEVER = np.finfo(float).tiny  # relative fall that ends a fit: `_ShapeSteps` tells the end
_DAMPING = Damping(least=1e-6, raised=1e-3, shrinkage=0.1, sufficient=1e-3, accepted=1e-3)


@dataclass(frozen=True, eq=False)
class ShapesOnSites(ModulusField):
    """A field of shapes on the quadrature points of a body.

    Attributes:
        shapes: The field.
        sites: Volumes of the quadrature points.
        held: A direction along which a fit does not change the coefficients, or None.
    """

    shapes: ShapeField
    sites: Sites
    held: Vector | None = None

    @property
    def size(self) -> int:  # type: ignore[override]
        return self.shapes.size

    @property
    def limits(self) -> tuple[Vector, Vector]:  # type: ignore[override]
        high = np.full(self.size, _MAX_Z)
        return -high, high

    @property
    def max_step(self) -> Vector:  # type: ignore[override]
        return np.full(self.size, _MAX_STEP)

    def at(self, x: Vector) -> "_ShapesPoint":
        return _ShapesPoint(self, x)


@dataclass(frozen=True, eq=False)
class _ShapesPoint(FieldPoint):
    field: ShapesOnSites
    x: Vector

    @cached_property
    def youngs(self) -> Float[np.ndarray, "m q"]:  # type: ignore[override]
        field = self.field
        return np.exp(field.shapes.log_youngs(self.x, field.sites)).reshape(field.sites.shape)

    @cached_property
    def _derivative(self) -> Float[np.ndarray, "volumes size"]:
        logs = self.field.shapes.jacobian(self.x, self.field.sites)
        return self.youngs.reshape(-1, 1) * logs

    @cached_property
    def penalty(self) -> float:  # type: ignore[override]
        return self.field.shapes.penalty(self.x)

    @cached_property
    def _excess_jacobian(self) -> Float[np.ndarray, "sides size"]:
        return self.field.shapes.excess_jacobian(self.x)

    @property
    def penalty_gradient(self) -> Vector:  # type: ignore[override]
        return self.x + self._excess_jacobian.T @ self.field.shapes.excess(self.x)

    @property
    def penalty_curvature(self) -> sp.csr_matrix:
        return sp.csr_matrix(np.eye(len(self.x)) + self._excess_jacobian.T @ self._excess_jacobian)

    def youngs_change(self, change: Vector) -> Float[np.ndarray, "m q"]:
        return (self._derivative @ change).reshape(self.field.sites.shape)

    def transpose_times(self, weights: Float[np.ndarray, "m q"]) -> Vector:
        return self._derivative.T @ weights.ravel()

    @property
    def changes(self) -> Float[np.ndarray, "size moduli"]:
        """Change of the moduli by each coefficient, MPa."""
        return np.ascontiguousarray(self._derivative.T)

    def jacobian(self, evaluation: Evaluation) -> Float[np.ndarray, "data size"]:
        return evaluation.linear_response(self.changes)[0]


@dataclass(frozen=True, eq=False)
class ShapeFit:
    """Shapes fitted to presses, with their posterior and evidence by the Laplace approximation.

    The complexity is minus the log-density of the prior, see `ShapeField.penalty`, and half the
    logarithm of the determinants of the posterior precision and of the covariance of the data.

    Attributes:
        residuals: Residuals of all data.
        complexity: Minus the logarithm of the evidence but for the residuals.
        field: The family of the shapes and the prior of its parameters.
        z: Parameters, in standard deviations of the prior.
        covariance: Their posterior covariance, for the stated noise.
        jacobian: Derivatives of the residuals by z.
        optimum: Parameters one Gauss-Newton step further, at which nothing is evaluated; z where
            that step is long or does not lower the objective.
    """

    residuals: Float[np.ndarray, " data"]
    complexity: float
    field: ShapeField
    z: Float[np.ndarray, " size"]
    covariance: Float[np.ndarray, "size size"]
    jacobian: Float[np.ndarray, "data size"]
    optimum: Float[np.ndarray, " size"]

    @staticmethod
    def at(
        point: _ShapesPoint,
        evaluation: Evaluation,
        jacobian: Float[np.ndarray, "data size"],
        optimum: Float[np.ndarray, " size"] | None = None,
    ) -> "ShapeFit":
        """Return the fit of predictions at the parameters of a point, with their derivatives."""
        residuals, z = evaluation.residuals, point.x
        hessian = jacobian.T @ jacobian + point.penalty_curvature.toarray()
        determinant = float(np.linalg.slogdet(hessian)[1]) + evaluation.data.log_determinant
        return ShapeFit(
            residuals, point.penalty + 0.5 * determinant, point.field.shapes, z,
            np.linalg.inv(hessian), jacobian, z if optimum is None else optimum,
        )  # fmt: skip

    @property
    def misfit(self) -> float:
        """Half the sum of squared residuals."""
        return 0.5 * float(self.residuals @ self.residuals)

    @property
    def chi2(self) -> float:
        """Mean squared residual, in standard deviations."""
        return 2.0 * self.misfit / len(self.residuals)

    def log_evidence(self, inflation: float = 1.0) -> float:
        """Return the log-evidence where the variance of the noise is `inflation` times as large.

        The determinant is that of the stated noise.
        """
        return -self.misfit / inflation - self.complexity

    @property
    def predicted_fall(self) -> float:
        """Fall of the objective by a Gauss-Newton step."""
        gradient = self.jacobian.T @ self.residuals + self.z
        return 0.5 * float(gradient @ self.covariance @ gradient)


def fit_shapes(
    problem: InverseProblem,
    field: ShapeField,
    start: Float[np.ndarray, " size"],
    *,
    sites: Sites | None = None,
    starts: Sequence[Float[np.ndarray, "nodes 3"]] | None = None,
    evaluation: Evaluation | None = None,
    max_iterations: int = 20,
    tolerance: float = 0.02,
    held: Vector | None = None,
    give_up: Callable[[ShapeFit, float], bool] = lambda fit, fall: False,
) -> tuple[ShapeFit, Evaluation]:
    """Fit shapes to the presses of a problem.

    Args:
        problem: The presses.
        field: The family of the shapes and the prior of its parameters.
        start: Parameters to start from, in standard deviations of the prior.
        sites: Volumes of the quadrature points, where they exist already.
        starts: Displacement of each press from which the equilibria start, mm.
        evaluation: The equilibria at the start, where they exist already.
        max_iterations: Limit of Gauss-Newton steps.
        tolerance: Predicted fall of the objective, over chi2 if that exceeds one, at which to stop.
            The parameters are then within some sqrt(2 tolerance) posterior standard deviations of
            the optimum. It also stops below a fall of 0.5 where errors of the derivatives prevent
            a descent.
        held: A direction along which the parameters do not change, or None.
        give_up: Called before each step with the present fit and the predicted fall of the
            objective; where it is true the fit ends there.

    Raises:
        ConvergenceError: the start has no equilibrium under the recorded forces.
    """
    family = ShapesOnSites(field, sites or Sites.of(problem.body.assembly), held)
    objective = Objective(problem, family, weight=1.0)
    if evaluation is None:
        point = objective.at(np.clip(start, *family.limits), starts=starts)
    else:
        point = Point(start, family.at(start), evaluation.with_data(problem.data), objective)
    steps, monitor = _ShapeSteps(tolerance, give_up), Monitor(log=False)
    if max_iterations:
        optimizer = GaussNewton(
            max_iterations=max_iterations, tolerance=_NEVER, damping=_DAMPING.least,
            max_trials=_MAX_TRIALS,
        )  # fmt: skip
        with suppress(StopOptimization):
            monitor.reason = optimizer.descend(point, steps, monitor)
        point = monitor.point or point
    return steps.fit(point, monitor.reason is StopReason.NO_DESCENT), point.evaluation


@dataclass(eq=False)
class _ShapeSteps(StepSolver):
    """Steps of the parameters of shapes; see `fit_shapes` for the attributes."""

    tolerance: float
    give_up: Callable[[ShapeFit, float], bool]
    damping = _DAMPING

    def linearize(
        self, point: Point, weight: float, gradient: Vector, free: Mask, lowering: bool
    ) -> None:
        self._point, self._gradient, jacobian = point, gradient, point.jacobian
        self._hessian = jacobian.T @ jacobian + point.prior_curvature(weight).toarray()
        self._basis = np.eye(len(gradient))[:, free]
        if (held := self._shapes_point.field.held) is not None:
            self._basis = self._basis @ null_space((held @ self._basis)[None])

    def solve(self, damping: float) -> Vector:
        """Return the damped step of the parameters that are neither at a bound nor held."""
        basis, hessian = self._basis, self._hessian + damping * np.diag(np.diag(self._hessian))
        step = np.linalg.solve(basis.T @ hessian @ basis, basis.T @ self._gradient)
        return -np.asarray(basis @ step)

    def predicted_fall(self, change: Vector) -> float:
        return -float(change @ self._gradient + 0.5 * change @ self._hessian @ change)

    def trials(self, limit: int) -> int:
        """Return one near the optimum, where errors of the derivatives may prevent a descent."""
        newton, chi2 = self.solve(0.0), self._point.evaluation.chi2
        predicted = self.predicted_fall(self.limited(self._point, newton)) / max(1.0, chi2)
        is_done = predicted <= self.tolerance
        if is_done or self.give_up(self._fit(self._point.x), self.predicted_fall(newton)):
            raise StopOptimization(StopReason.CONVERGED)
        return 1 if predicted <= _ROUND_OFF else limit

    def limited(self, point: Point, change: Vector) -> Vector:
        """Return a step shortened as a whole, which keeps its direction but at bounds."""
        longest = float((np.abs(change) / point.objective.max_step).max())
        return within_bounds(point, change / max(1.0, longest))

    def moved(self, point: Point, change: Vector) -> Point:
        _, fields = point.evaluation.linear_response(self._shapes_point.changes)
        starts = point.evaluation.moved([np.tensordot(change, field, 1) for field in fields])
        after = point.objective.at(self._after(change), starts=starts)
        assert isinstance(after.field, _ShapesPoint)
        changes = after.field.changes
        after.evaluation.update_response(changes, point.evaluation, after.x - point.x)
        return after

    @property
    def _shapes_point(self) -> _ShapesPoint:
        assert isinstance(self._point.field, _ShapesPoint)
        return self._point.field

    def _after(self, step: Vector) -> Vector:
        """Return the parameters after a step, within bounds."""
        x, family = self._point.x, self._shapes_point.field
        z = x + step if family.held is not None else family.shapes.moved(x, step)
        return np.clip(z, *family.limits)

    def fit(self, point: Point, refused: bool) -> ShapeFit:
        """Return the fit at a point; a refused step does not lead to the optimum."""
        gradient = self.data_gradient(point) + point.prior_gradient(1.0)
        free = projected_gradient(point.x, gradient, point.objective.limits) != 0.0
        self.linearize(point, 1.0, gradient, free, False)
        step = self.limited(point, self.solve(0.0))
        is_long = self.predicted_fall(step) > _ROUND_OFF * max(1.0, point.evaluation.chi2)
        return self._fit(point.x if refused or is_long else self._after(step))

    def _fit(self, optimum: Vector) -> ShapeFit:
        point = self._point
        return ShapeFit.at(self._shapes_point, point.evaluation, point.jacobian, optimum)

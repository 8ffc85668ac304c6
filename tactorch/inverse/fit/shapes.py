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

from tactorch.errors import ConvergenceError
from tactorch.inverse.fields import FieldPoint, ModulusField, ShapeField, Sites, Vector
from tactorch.inverse.fit.optimizers.damped import projected_gradient
from tactorch.inverse.forward.problem import Evaluation, InverseProblem

_MAX_STEP, _MAX_Z = 0.5, 4.0  # of a coefficient, in standard deviations of its prior
_DAMPING, _RAISED_DAMPING = 1e-6, 1e-2  # smallest ones, over the Hessian's diagonal
_MAX_TRIALS = 8  # of growing damping
_ROUND_OFF = 0.5  # predicted fall below which errors of the derivatives may prevent a descent
_MIN_GAIN = 1e-3  # smallest fall of the objective over the predicted one


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
        """Number of coefficients."""
        return self.shapes.size

    @property
    def limits(self) -> tuple[Vector, Vector]:  # type: ignore[override]
        """Bounds of the coefficients, in standard deviations of the prior."""
        high = np.full(self.size, _MAX_Z)
        return -high, high

    @property
    def max_step(self) -> Vector:  # type: ignore[override]
        """Largest change of each coefficient in one damped Newton step."""
        return np.full(self.size, _MAX_STEP)

    def at(self, x: Vector) -> "_ShapesPoint":
        """Return the field with these coefficients."""
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

    @property
    def penalty(self) -> float:  # type: ignore[override]
        return 0.5 * float(self.x @ self.x)

    @property
    def penalty_gradient(self) -> Vector:  # type: ignore[override]
        return self.x

    @property
    def penalty_curvature(self) -> sp.csr_matrix:
        return sp.identity(len(self.x), format="csr")

    def youngs_change(self, change: Vector) -> Float[np.ndarray, "m q"]:
        return (self._derivative @ change).reshape(self.field.sites.shape)

    def transpose_times(self, weights: Float[np.ndarray, "m q"]) -> Vector:
        return self._derivative.T @ weights.ravel()

    @property
    def changes(self) -> Float[np.ndarray, "size moduli"]:
        """Change of the moduli by each coefficient, MPa."""
        return np.ascontiguousarray(self._derivative.T)

    def jacobian(self, evaluation: Evaluation) -> Float[np.ndarray, "data size"]:
        return evaluation.jacobian_times_each(self.changes)


@dataclass(frozen=True, eq=False)
class ShapeFit:
    """Shapes fitted to presses, with their posterior.

    Attributes:
        field: The family of the shapes and the prior of its parameters.
        z: Parameters, in standard deviations of the prior.
        covariance: Their posterior covariance, for the stated noise.
        chi2: Mean squared residual, in standard deviations.
        misfit: Half the sum of squared residuals.
        penalty: Minus the log-density of the prior, see `ShapeField.penalty`.
        log_determinant: Half the logarithm of the determinants of the posterior precision and of
            the covariance of the data.
        residuals: Residuals of all data.
        jacobian: Their derivatives by z.
        optimum: Parameters one Gauss-Newton step further, at which nothing is evaluated; z where
            that step is long or does not lower the objective.
    """

    field: ShapeField
    z: Float[np.ndarray, " size"]
    covariance: Float[np.ndarray, "size size"]
    chi2: float
    misfit: float
    penalty: float
    log_determinant: float
    residuals: Float[np.ndarray, " data"]
    jacobian: Float[np.ndarray, "data size"]
    optimum: Float[np.ndarray, " size"]

    def log_evidence(self, inflation: float = 1.0) -> float:
        """Return the log-evidence where the variance of the noise is `inflation` times as large.

        The determinant is that of the stated noise.
        """
        return -self.misfit / inflation - self.penalty - self.log_determinant


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
    if evaluation is None:
        state = _State.at(problem, family, np.clip(start, *family.limits), starts)
    else:
        state = _State(family, _ShapesPoint(family, start), evaluation.with_data(problem.data))
    damping = _DAMPING
    for _ in range(max_iterations):
        fall = state.predicted_fall(state.newton_step())
        predicted = state.predicted_fall(state.step(0.0)) / max(1.0, state.evaluation.chi2)
        if predicted <= tolerance or give_up(state.fit(problem), fall):
            break
        for _ in range(_MAX_TRIALS):
            step = state.step(damping)
            trial = state.moved(problem, step)
            if trial and state.value - trial.value > _MIN_GAIN * state.predicted_fall(step):
                break
            if predicted <= _ROUND_OFF:
                return state.fit(problem, refused=True), state.evaluation
            damping = max(10.0 * damping, _RAISED_DAMPING)
        else:
            return state.fit(problem, refused=True), state.evaluation
        state, damping = trial, max(0.1 * damping, _DAMPING)
    return state.fit(problem), state.evaluation


@dataclass(frozen=True, eq=False)
class _State:
    """The objective and its derivatives at one vector of parameters."""

    family: ShapesOnSites
    point: _ShapesPoint
    evaluation: Evaluation

    @staticmethod
    def at(
        problem: InverseProblem,
        family: ShapesOnSites,
        z: Vector,
        starts: Sequence[Float[np.ndarray, "nodes 3"]] | None,
    ) -> "_State":
        point = _ShapesPoint(family, z)
        return _State(family, point, problem.evaluate(point.youngs, starts=starts))

    @property
    def z(self) -> Vector:
        return self.point.x

    @cached_property
    def value(self) -> float:
        residuals = self.evaluation.residuals
        return 0.5 * float(residuals @ residuals) + self.family.shapes.penalty(self.z)

    @cached_property
    def _excess(self) -> Float[np.ndarray, " sides"]:
        return self.family.shapes.excess(self.z)

    @cached_property
    def _excess_jacobian(self) -> Float[np.ndarray, "sides size"]:
        return self.family.shapes.excess_jacobian(self.z)

    @cached_property
    def _response(self) -> tuple[np.ndarray, list[np.ndarray]]:
        """Derivatives of the residuals, and of the displacements of each press."""
        return self.evaluation.linear_response(self.point.changes)

    @cached_property
    def _gradient(self) -> Vector:
        of_data = self._response[0].T @ self.evaluation.residuals
        return of_data + self.z + self._excess_jacobian.T @ self._excess

    @cached_property
    def _hessian(self) -> Float[np.ndarray, "size size"]:
        jacobian = np.vstack([self._response[0], self._excess_jacobian])
        return jacobian.T @ jacobian + np.eye(len(self.z))

    def newton_step(self, damping: float = 0.0) -> Vector:
        """Return the damped step of the parameters that are neither at a bound nor held."""
        free = projected_gradient(self.z, self._gradient, self.family.limits) != 0.0
        hessian = self._hessian + damping * np.diag(np.diag(self._hessian))
        basis = np.eye(len(self.z))[:, free]
        if self.family.held is not None:
            basis = basis @ null_space((self.family.held @ basis)[None])
        step = np.linalg.solve(basis.T @ hessian @ basis, basis.T @ self._gradient)
        return -np.asarray(basis @ step)

    def step(self, damping: float) -> Vector:
        """Return the damped step, shortened to where linearisation is meaningful, within bounds."""
        step = self.newton_step(damping)
        step /= max(1.0, float((np.abs(step) / self.family.max_step).max()))
        return np.clip(self.z + step, *self.family.limits) - self.z

    def predicted_fall(self, step: Vector) -> float:
        """Return the fall of the quadratic model along a step."""
        return -float(step @ self._gradient + 0.5 * step @ self._hessian @ step)

    def moved(self, problem: InverseProblem, step: Vector) -> "_State | None":
        """Return the state after a step; None where a press has no equilibrium."""
        changes = [np.tensordot(step, fields, 1) for fields in self._response[1]]
        starts = self.evaluation.moved(changes)
        with suppress(ConvergenceError):
            return _State.at(problem, self.family, self._after(step), starts)
        return None

    def _after(self, step: Vector) -> Vector:
        """Return the parameters after a step, within bounds."""
        straight = self.family.held is not None
        z = self.z + step if straight else self.family.shapes.moved(self.z, step)
        return np.clip(z, *self.family.limits)

    def _optimum(self) -> Vector:
        step = self.step(0.0)
        is_long = self.predicted_fall(step) > _ROUND_OFF * max(1.0, self.evaluation.chi2)
        return self.z if is_long else self._after(step)

    def fit(self, problem: InverseProblem, refused: bool = False) -> ShapeFit:
        """Return the fit with its posterior; a refused step does not lead to the optimum."""
        residuals = self.evaluation.residuals
        determinant = float(np.linalg.slogdet(self._hessian)[1]) + problem.data.log_determinant
        return ShapeFit(
            self.family.shapes,
            self.z,
            np.linalg.inv(self._hessian),
            self.evaluation.chi2,
            0.5 * float(residuals @ residuals),
            self.family.shapes.penalty(self.z),
            0.5 * determinant,
            residuals,
            self._response[0],
            self.z if refused else self._optimum(),
        )

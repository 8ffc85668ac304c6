"""The fit of a field of shapes to presses, its posterior and its evidence.

The fit minimises half the sum of squared residuals plus that of the coefficients in standard
deviations of their prior, by the damped Gauss-Newton of all inversions. The posterior is normal
(Laplace approximation), and so is the evidence: log Z = -(|r|^2 + |z|^2) / 2 - log det(H) / 2 with
H = J^T J + 1 (MacKay, Information Theory, Inference, and Learning Algorithms, 2003, chapter 28), up
to a constant of the data.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float

from tactorch.inverse.fields import FieldPoint, ModulusField, Vector
from tactorch.inverse.monitor import Monitor
from tactorch.inverse.objective import Objective
from tactorch.inverse.optimizers.gauss_newton import GaussNewton
from tactorch.inverse.problem import Evaluation, InverseProblem
from tactorch.inverse.shapes.field import ShapeField, Sites

_MAX_STEP, _MAX_Z = 0.5, 4.0  # of a coefficient, in standard deviations of its prior


@dataclass(frozen=True, eq=False)
class ShapesOnSites(ModulusField):
    """A field of shapes on the quadrature points of a body.

    Attributes:
        shapes: The field.
        sites: Volumes of the quadrature points.
    """

    shapes: ShapeField
    sites: Sites

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

    def at(self, x: Vector) -> FieldPoint:
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

    def jacobian(self, evaluation: Evaluation) -> Float[np.ndarray, "data size"]:
        return evaluation.jacobian_times_each(np.ascontiguousarray(self._derivative.T))


@dataclass(frozen=True, eq=False)
class ShapeFit:
    """Shapes fitted to presses, with their posterior.

    Attributes:
        field: The family of the shapes and the prior of its parameters.
        z: Parameters, in standard deviations of the prior.
        covariance: Their posterior covariance.
        chi2: Mean squared residual, in standard deviations.
        misfit: Half the sum of squared residuals.
        log_determinant: Half the logarithm of the determinants of the posterior precision and of
            the covariance of the data.
        residuals: Residuals of all data.
        jacobian: Their derivatives by z.
    """

    field: ShapeField
    z: Float[np.ndarray, " size"]
    covariance: Float[np.ndarray, "size size"]
    chi2: float
    misfit: float
    log_determinant: float
    residuals: Float[np.ndarray, " data"]
    jacobian: Float[np.ndarray, "data size"]

    def log_evidence(self, inflation: float = 1.0) -> float:
        """Return the log-evidence where the variance of the noise is `inflation` times as large.

        The determinant is that of the stated noise.
        """
        return -self.misfit / inflation - 0.5 * float(self.z @ self.z) - self.log_determinant


def fit_shapes(
    problem: InverseProblem,
    field: ShapeField,
    start: Float[np.ndarray, " size"],
    *,
    sites: Sites | None = None,
    starts: Sequence[Float[np.ndarray, "nodes 3"]] | None = None,
    max_iterations: int = 20,
    tolerance: float = 1e-4,
) -> tuple[ShapeFit, Evaluation]:
    """Fit shapes to the presses of a problem.

    Args:
        problem: The presses.
        field: The family of the shapes and the prior of its parameters.
        start: Parameters to start from, in standard deviations of the prior.
        sites: Volumes of the quadrature points, where they exist already.
        starts: Displacement of each press from which the equilibria start, mm.
        max_iterations: Limit of Gauss-Newton steps.
        tolerance: Relative fall of the objective at which to stop.

    Raises:
        ConvergenceError: the start has no equilibrium under the recorded forces.
    """
    sites = sites or Sites.of(problem.body.assembly)
    objective = Objective(problem, ShapesOnSites(field, sites), weight=1.0, starts=starts)
    monitor = Monitor(log=False)
    optimizer = GaussNewton(
        max_iterations=max_iterations, tolerance=tolerance, max_trials=8, space="parameter"
    )
    optimizer.minimize(objective, np.clip(start, *objective.limits), monitor)
    point = monitor.point
    assert point is not None
    hessian = point.jacobian.T @ point.jacobian + np.eye(field.size)
    residuals = point.evaluation.residuals
    fit = ShapeFit(
        field,
        point.x,
        np.linalg.inv(hessian),
        point.evaluation.chi2,
        0.5 * float(residuals @ residuals),
        0.5 * (float(np.linalg.slogdet(hessian)[1]) + problem.data.log_determinant),
        residuals,
        point.jacobian,
    )
    return fit, point.evaluation

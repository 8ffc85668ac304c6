"""The fit of a field of shapes to presses, its posterior and its evidence.

The fit minimises half the sum of squared residuals plus that of the parameters in standard
deviations of their prior, by the damped Gauss-Newton of all inversions. The posterior is normal
(Laplace approximation), and so is the evidence: log Z = -(|r|^2 + |z|^2) / 2 - log det(H) / 2 with
H = J^T J + 1 (MacKay, Information Theory, Inference, and Learning Algorithms, 2003, chapter 28), up
to a constant of the data.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float

from tactorch.inverse.monitor import Monitor
from tactorch.inverse.optimizers.gauss_newton import GaussNewton
from tactorch.inverse.problem import Evaluation, InverseProblem
from tactorch.inverse.shapes.field import Ellipsoid, ShapeField, Sites

_MAX_STEP, _MAX_Z = 1.0, 4.0  # of a parameter, in standard deviations of its prior


@dataclass(frozen=True, eq=False)
class _Point:
    """The terms of the objective at one vector of parameters; see `objective.Point`."""

    x: Float[np.ndarray, " size"]
    evaluation: Evaluation
    objective: "ShapeObjective"

    @property
    def youngs(self) -> np.ndarray:
        return self.evaluation.youngs

    @cached_property
    def jacobian(self) -> Float[np.ndarray, "data size"]:
        by_parameter = self.objective.field.jacobian(self.x, self.objective.sites)
        changes = self.youngs.reshape(-1, 1) * by_parameter
        return np.column_stack([self.evaluation.jacobian_times(change) for change in changes.T])

    def value(self, weight: float) -> float:
        residuals = self.evaluation.residuals
        return 0.5 * float(residuals @ residuals + weight * self.x @ self.x)

    def prior_gradient(self, weight: float) -> np.ndarray:
        return weight * self.x

    def prior_curvature(self, weight: float) -> sp.csr_matrix:
        return weight * sp.identity(len(self.x), format="csr")


@dataclass(frozen=True, eq=False)
class ShapeObjective:
    """A field of shapes as the unknown of an inverse problem."""

    problem: InverseProblem
    field: ShapeField
    sites: Sites
    weight: float = 1.0

    @property
    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of the parameters."""
        high = np.full(self.field.size, _MAX_Z)
        return -high, high

    @property
    def max_step(self) -> np.ndarray:
        """Largest change of a parameter in one step."""
        return np.full(self.field.size, _MAX_STEP)

    def at(self, x: np.ndarray, near: _Point | None = None, *, take_over: bool = False) -> _Point:
        """Evaluate at x, starting the equilibria from a nearby point."""
        youngs = np.exp(self.field.log_youngs(x, self.sites)).reshape(self.sites.shape)
        before = None if near is None else near.evaluation
        evaluation = self.problem.evaluate(youngs, before, take_over=take_over)
        return _Point(x, evaluation, self)


@dataclass(frozen=True, eq=False)
class ShapeFit:
    """Shapes fitted to presses, with their posterior.

    Attributes:
        field: The family of the shapes and the prior of its parameters.
        z: Parameters, in standard deviations of the prior.
        covariance: Their posterior covariance.
        chi2: Mean squared residual, in standard deviations.
        misfit: Half the sum of squared residuals.
        log_evidence: Logarithm of the evidence, up to a constant of the data.
        residuals: Residuals of all data.
    """

    field: ShapeField
    z: Float[np.ndarray, " size"]
    covariance: Float[np.ndarray, "size size"]
    chi2: float
    misfit: float
    log_determinant: float
    residuals: Float[np.ndarray, " data"]

    def log_evidence(self, inflation: float = 1.0) -> float:
        """Return the log-evidence where the variance of the noise is `inflation` times as large.

        The determinant is that of the stated noise.
        """
        return -self.misfit / inflation - 0.5 * float(self.z @ self.z) - self.log_determinant

    @property
    def shapes(self) -> list[Ellipsoid]:
        """The inclusions."""
        return list(self.field.shapes(self.z))

    @property
    def background_mpa(self) -> float:
        """Young's modulus of the background, MPa."""
        return float(np.exp(self.field.physical(self.z)[0]))

    def youngs_at(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Return Young's modulus at points (mm), MPa."""
        return np.exp(self.field.log_youngs(self.z, Sites.at(points)))

    def sample(self, draws: int, seed: int = 0) -> Float[np.ndarray, "draws size"]:
        """Draw parameters from the posterior."""
        rng = np.random.default_rng(seed)
        return rng.multivariate_normal(self.z, self.covariance, size=draws, method="eigh")

    @property
    def deviations(self) -> Float[np.ndarray, " size"]:
        """Standard deviations of the parameters in mm and logarithms; see `ShapeField`."""
        spread = self.field.physical(np.eye(len(self.z))) - self.field.physical(0.0 * self.z)
        return np.sqrt(self.covariance.diagonal()) * np.diag(spread)


def fit_shapes(
    problem: InverseProblem,
    field: ShapeField,
    start: Float[np.ndarray, " size"],
    *,
    sites: Sites | None = None,
    max_iterations: int = 20,
    tolerance: float = 1e-4,
) -> ShapeFit:
    """Fit shapes to the presses of a problem.

    Args:
        problem: The presses.
        field: The family of the shapes and the prior of its parameters.
        start: Parameters to start from, in standard deviations of the prior.
        sites: Volumes of the quadrature points, where they exist already.
        max_iterations: Limit of Gauss-Newton steps.
        tolerance: Relative fall of the objective at which to stop.

    Raises:
        ConvergenceError: the start has no equilibrium under the recorded forces.
    """
    sites = sites or Sites.of(problem.body.assembly)
    objective, monitor = ShapeObjective(problem, field, sites), Monitor(log=False)
    optimizer = GaussNewton(
        max_iterations=max_iterations, tolerance=tolerance, max_trials=8, space="parameter"
    )
    optimizer.minimize(objective, np.clip(start, *objective.limits), monitor)  # type: ignore[arg-type]
    point = monitor.point
    assert point is not None
    hessian = point.jacobian.T @ point.jacobian + np.eye(field.size)
    residuals = point.evaluation.residuals
    return ShapeFit(
        field,
        point.x,
        np.linalg.inv(hessian),
        point.evaluation.chi2,
        0.5 * float(residuals @ residuals),
        0.5 * float(np.linalg.slogdet(hessian)[1]),
        residuals,
    )

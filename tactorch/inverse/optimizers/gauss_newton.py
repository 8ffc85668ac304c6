"""Gauss-Newton on the full sensitivity matrix J = d residuals / d x (eq. 13)."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float

from tactorch.config import option
from tactorch.inverse.objective import Point
from tactorch.inverse.optimizers.damped import DampedNewton, LinearSystem, StepSolver
from tactorch.inverse.optimizers.schedule import RegularizationSchedule
from tactorch.linalg import DenseCholesky, Solver, SymmetricPattern, analyse

# Data space divides by the damping where the prior is zero (a uniform shift).
_MIN_SHIFT = 1e-9
# Small damping costs digits there: a sweep of refinement restores two or more.
_MAX_SWEEPS, _SWEEP_RTOL, _MAX_RESIDUAL = 8, 1e-12, 1e-6
_DATA_SPACE = 0.8  # data per parameter below which data space is cheaper


@dataclass(frozen=True)
class GaussNewton(DampedNewton):
    """Gauss-Newton with Levenberg-Marquardt damping on the full sensitivity matrix.

    Attributes:
        max_iterations: Limit of accepted steps.
        tolerance: Relative fall of the objective, at a final weight, at which to stop.
        damping: First damping, relative to the diagonal of the Hessian.
        max_trials: Limit of trial steps at one iterate.
        space: Space of the linear system: "data" (p x p), "parameter" (m x m), or "auto" by size.
        weight_rule: Rule that chooses the weight of a prior whose weight is not given.
    """

    space: Literal["auto", "data", "parameter"] = option("auto", "Space of the linear system")
    weight_rule: Literal["discrepancy", "l_curve", "gcv"] = option(
        "discrepancy", "Rule that chooses the weight of the prior"
    )

    def step_solver(self, point: Point, state: dict[str, float]) -> StepSolver:
        """Return the solver of a run."""
        return _DenseSteps(self)


@dataclass(frozen=True, eq=False)
class _DenseSteps(StepSolver):
    settings: GaussNewton

    def schedule(self, point: Point, state: dict[str, float]) -> RegularizationSchedule:
        return RegularizationSchedule.start(point, state, self.settings.weight_rule)

    def data_gradient(self, point: Point) -> Float[np.ndarray, " size"]:
        return point.jacobian.T @ point.evaluation.residuals

    def linearize(
        self,
        point: Point,
        weight: float,
        gradient: Float[np.ndarray, " size"],
        free: Bool[np.ndarray, " size"],
        lowering: bool,
    ) -> LinearSystem:
        jacobian, prior = point.jacobian, point.prior_curvature(weight)
        diagonal = np.einsum("ij,ij->j", jacobian, jacobian) + prior.diagonal()
        return _DenseSystem(self.settings.space, jacobian, prior, gradient, free, diagonal)


@dataclass(frozen=True, eq=False)
class _DenseSystem:
    space: str
    jacobian: Float[np.ndarray, "p size"]
    prior: sp.csr_matrix
    gradient: Float[np.ndarray, " size"]
    free: Bool[np.ndarray, " size"]
    diagonal: Float[np.ndarray, " size"]

    def solve(self, damping: float) -> Float[np.ndarray, " size"] | None:
        free, jacobian, prior = self.free, self.jacobian, self.prior
        if not free.all():
            jacobian, prior = jacobian[:, free], prior[free][:, free]
        data, parameters = jacobian.shape
        in_data = self.space == "auto" and data < _DATA_SPACE * parameters
        solve = data_space_step if in_data or self.space == "data" else parameter_space_step
        step = solve(jacobian, self.gradient[free], prior, damping * self.diagonal[free])
        if step is None or not np.all(np.isfinite(step)):
            return None
        change = np.zeros_like(self.gradient)
        change[free] = step
        return change

    def predicted_fall(self, change: Float[np.ndarray, " size"]) -> float:
        image = self.jacobian @ change
        curvature = image @ image + change @ (self.prior @ change)
        return -float(self.gradient @ change + 0.5 * curvature)


def parameter_space_step(
    jacobian: Float[np.ndarray, "p m"],
    gradient: Float[np.ndarray, " m"],
    prior: sp.csr_matrix,
    shift: Float[np.ndarray, " m"],
) -> Float[np.ndarray, " m"] | None:
    """Solve (J^T J + prior + shift) step = -gradient by Cholesky; None if it breaks down."""
    matrix = jacobian.T @ jacobian
    coo = prior.tocoo()
    np.add.at(matrix, (coo.row, coo.col), coo.data)
    matrix[np.diag_indices_from(matrix)] += shift
    factor = DenseCholesky.of(matrix)
    return None if factor is None else -factor.solve(gradient)


def data_space_step(
    jacobian: Float[np.ndarray, "p m"],
    gradient: Float[np.ndarray, " m"],
    prior: sp.csr_matrix,
    shift: Float[np.ndarray, " m"],
) -> Float[np.ndarray, " m"] | None:
    """Solve the same system through p x p matrices (Woodbury), for fewer data than parameters.

    With A = prior + shift, sparse: step = -A^-1 g + A^-1 J^T (1 + J A^-1 J^T)^-1 J A^-1 g, then
    refined against the system itself.
    """
    shift = np.maximum(shift, _MIN_SHIFT * shift.max())
    solver, values = _sparse_part(prior, shift)
    if not solver.factor(values):
        return None
    image = solver.solve(np.asfortranarray(jacobian.T))
    capacitance = jacobian @ image
    capacitance[np.diag_indices_from(capacitance)] += 1.0
    factor = DenseCholesky.of(capacitance)
    if factor is None:
        return None
    step, residual = np.zeros_like(gradient), -gradient
    target = _SWEEP_RTOL * np.abs(gradient).max()
    for _ in range(_MAX_SWEEPS):
        direction = solver.solve(residual)
        step += direction - image @ factor.solve(jacobian @ direction)
        residual = -gradient - jacobian.T @ (jacobian @ step) - prior @ step - shift * step
        if np.abs(residual).max() <= target:
            break
    # Refinement may stall at round-off, but must not have failed.
    return step if np.abs(residual).max() <= _MAX_RESIDUAL * np.abs(gradient).max() else None


def _sparse_part(prior: sp.csr_matrix, shift: np.ndarray) -> tuple[Solver, np.ndarray]:
    """Return an analysed solver and the stored values of prior + diagonal."""
    coo = prior.tocoo()
    pattern = SymmetricPattern.from_pairs(
        len(shift), coo.row.astype(np.int64), coo.col.astype(np.int64)
    )
    values = np.zeros(pattern.nnz)
    upper = coo.row <= coo.col
    np.add.at(values, pattern.slots(coo.row[upper], coo.col[upper]), coo.data[upper])
    values[pattern.diagonal] += shift
    return analyse(pattern, "auto"), values

"""Gauss-Newton on the full sensitivity matrix J = d residuals / d x (eq. 13)."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float

from tactorch.config import option
from tactorch.inverse.fit.objective import Point
from tactorch.inverse.fit.optimizers.damped import (
    DampedNewton,
    Mask,
    PriorSolver,
    StepSolver,
    Vector,
)
from tactorch.linalg import DenseCholesky

# Data space divides by the damping where the prior is zero (a uniform shift).
_MIN_SHIFT = 1e-9
# Small damping costs digits there: a sweep of refinement restores two or more.
_MAX_SWEEPS, _SWEEP_RTOL, _MAX_RESIDUAL = 8, 1e-12, 1e-6
_DATA_SPACE = 0.8  # data per parameter below which data space is cheaper


@dataclass(frozen=True)
class GaussNewton(DampedNewton):
    """Gauss-Newton with Levenberg-Marquardt damping on the full sensitivity matrix."""

    space: Literal["auto", "data", "parameter"] = option("auto", "Space of the linear system")
    weight_rule: Literal["discrepancy", "l_curve", "gcv"] = option(
        "discrepancy", "Rule that chooses the weight of the prior"
    )

    def step_solver(self, point: Point, state: dict[str, float]) -> StepSolver:
        return _DenseSteps(self, takes_over=point.evaluation.derivative_rtol > 0.0)


class _DenseSteps(StepSolver):
    def __init__(self, settings: GaussNewton, takes_over: bool) -> None:
        self.takes_over = takes_over
        self._space, self.weight_rule = settings.space, settings.weight_rule

    def linearize(
        self, point: Point, weight: float, gradient: Vector, free: Mask, lowering: bool
    ) -> None:
        self._jacobian, self._prior = point.jacobian, point.prior_curvature(weight)
        self._gradient, self._free = gradient, free
        squares = np.einsum("ij,ij->j", self._jacobian, self._jacobian)
        self._diagonal = squares + self._prior.diagonal()

    def solve(self, damping: float) -> Vector | None:
        free, jacobian, prior = self._free, self._jacobian, self._prior
        if not free.all():
            jacobian, prior = jacobian[:, free], prior[free][:, free]
        data, parameters = jacobian.shape
        in_data = self._space == "auto" and data < _DATA_SPACE * parameters
        solve = data_space_step if in_data or self._space == "data" else parameter_space_step
        step = solve(jacobian, self._gradient[free], prior, damping * self._diagonal[free])
        if step is None or not np.all(np.isfinite(step)):
            return None
        change = np.zeros_like(self._gradient)
        change[free] = step
        return change

    def predicted_fall(self, change: Vector) -> float:
        image = self._jacobian @ change
        curvature = image @ image + change @ (self._prior @ change)
        return -float(self._gradient @ change + 0.5 * curvature)


def parameter_space_step(
    jacobian: Float[np.ndarray, "p size"], gradient: Vector, prior: sp.csr_matrix, shift: Vector
) -> Vector | None:
    """Solve (J^T J + prior + shift) step = -gradient by Cholesky; None if it breaks down."""
    factor = DenseCholesky.of(jacobian.T @ jacobian, prior + sp.diags(shift))
    return None if factor is None else -factor.solve(gradient)


def data_space_step(
    jacobian: Float[np.ndarray, "p size"], gradient: Vector, prior: sp.csr_matrix, shift: Vector
) -> Vector | None:
    """Solve the same system through p x p matrices (Woodbury), for fewer data than parameters.

    With A = prior + shift, sparse: step = -A^-1 g + A^-1 J^T (1 + J A^-1 J^T)^-1 J A^-1 g, then
    refined against the system itself.
    """
    shift = np.maximum(shift, _MIN_SHIFT * shift.max())
    solver = PriorSolver()
    if not solver.factor(prior, shift):
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

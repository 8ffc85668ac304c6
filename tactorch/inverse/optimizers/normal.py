"""The linear system of a Gauss-Newton step, in parameter space or in data space."""

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float

from tactorch.linalg import DenseCholesky, Solver, Status, SymmetricPattern, analyse

# Data space divides by the damping where the prior says nothing (a uniform shift).
_SMALLEST_SHIFT = 1e-9
# Small damping costs digits there: a sweep of refinement brings back two at the least.
_SWEEPS, _REFINED, _USELESS = 8, 1e-12, 1e-6


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
    """Solve the same system through p x p matrices (Woodbury), for fewer data than unknowns.

    With A = prior + shift, sparse: step = -A^-1 g + A^-1 J^T (1 + J A^-1 J^T)^-1 J A^-1 g, then
    refined against the system itself.
    """
    shift = np.maximum(shift, _SMALLEST_SHIFT * shift.max())
    solver, values = _sparse_part(prior, shift)
    if solver.factor(values) is Status.INDEFINITE:
        return None
    spread = solver.solve(np.asfortranarray(jacobian.T))
    inner = jacobian @ spread
    inner[np.diag_indices_from(inner)] += 1.0
    factor = DenseCholesky.of(inner)
    if factor is None:
        return None
    step, missing = np.zeros_like(gradient), -gradient
    goal = _REFINED * np.abs(gradient).max()
    for _ in range(_SWEEPS):
        plain = solver.solve(missing)
        step += plain - spread @ factor.solve(jacobian @ plain)
        missing = -gradient - jacobian.T @ (jacobian @ step) - prior @ step - shift * step
        if np.abs(missing).max() <= goal:
            break
    # Refinement may stall at round-off, but must not have failed.
    return step if np.abs(missing).max() <= _USELESS * np.abs(gradient).max() else None


def _sparse_part(prior: sp.csr_matrix, shift: np.ndarray) -> tuple[Solver, np.ndarray]:
    """Analysed solver and stored values of prior + diagonal."""
    coo = prior.tocoo()
    pattern = SymmetricPattern.from_pairs(
        len(shift), coo.row.astype(np.int64), coo.col.astype(np.int64)
    )
    values = np.zeros(pattern.nnz)
    upper = coo.row <= coo.col
    np.add.at(values, pattern.slots(coo.row[upper], coo.col[upper]), coo.data[upper])
    values[pattern.diagonal] += shift
    return analyse(pattern, "auto"), values

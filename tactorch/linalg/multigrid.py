"""Conjugate gradients with smoothed-aggregation multigrid, for the largest meshes.

The near-nullspace handed over (the six rigid-body modes in elasticity) is what makes the
aggregation converge independently of mesh size. Reference: Vanek, Mandel, Brezina (1996).
"""

from typing import Any

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float

from tactorch.linalg.pattern import SymmetricPattern
from tactorch.linalg.protocol import IndefiniteError, Status


class Multigrid:
    """Iterative solver; see `tactorch.linalg.Solver`.

    Args:
        pattern: The matrix pattern, three unknowns a node.
        near_nullspace: Columns that the operator nearly annihilates, (size, modes).
        rtol: Residual, relative to the right-hand side, at which a solve ends.
        max_iterations: Cap of a solve.

    Raises:
        RuntimeError: a solve did not reach `rtol` (in `solve`).
        IndefiniteError: negative curvature was met (in `solve`).
    """

    name = "multigrid"
    direct = False
    single_precision = False

    def __init__(
        self,
        pattern: SymmetricPattern,
        near_nullspace: Float[np.ndarray, "size modes"] | None = None,
        rtol: float = 1e-12,
        max_iterations: int = 500,
    ) -> None:
        """Keep the pattern; the hierarchy depends on the values and is built in `factor`."""
        self.pattern = pattern
        self.rtol = rtol
        self.max_iterations = max_iterations
        self._modes = near_nullspace
        self._aggregates: list[sp.csr_matrix] | None = None
        self._matrix: sp.csr_matrix | None = None
        self._preconditioner: Any = None

    def factor(self, values: Float[np.ndarray, " nnz"]) -> Status:
        """Build the hierarchy; its aggregates are chosen once and kept for later values."""
        import pyamg

        full = self.pattern.full(values)
        if not np.all(np.isfinite(values)) or np.any(full.diagonal() <= 0):
            return Status.INDEFINITE
        self._matrix = full
        block = full.tobsr((3, 3)) if self.pattern.size % 3 == 0 else full
        options: dict[str, Any] = {
            "max_coarse": 300,
            "coarse_solver": "splu",
            "symmetry": "symmetric",
        }
        if self._modes is not None:
            options["B"] = self._held_modes(full)
        if self._aggregates:
            options["aggregate"] = [("predefined", {"AggOp": a}) for a in self._aggregates]
            options["max_levels"] = len(self._aggregates) + 1
        hierarchy = pyamg.smoothed_aggregation_solver(block, keep=True, **options)
        if self._aggregates is None:
            self._aggregates = [level.AggOp for level in hierarchy.levels[:-1]]
        self._preconditioner = hierarchy.aspreconditioner(cycle="V")
        return Status.OK

    def _held_modes(self, full: sp.csr_matrix) -> np.ndarray:
        """Modes with the held unknowns (rows that are only a diagonal) set to zero."""
        modes = np.array(self._modes, dtype=np.float64)
        sums = np.asarray(abs(full).sum(axis=1)).ravel()
        modes[sums == np.abs(full.diagonal())] = 0.0
        return modes

    def solve(self, rhs: Float[np.ndarray, "size *k"]) -> Float[np.ndarray, "size *k"]:
        """Solve column by column."""
        if self._matrix is None:
            raise RuntimeError("factor the matrix before solving")
        if rhs.ndim == 1:
            return self._conjugate_gradients(rhs)
        return np.stack([self._conjugate_gradients(column) for column in rhs.T], axis=1)

    def _conjugate_gradients(self, rhs: Float[np.ndarray, " size"]) -> Float[np.ndarray, " size"]:
        x = np.zeros_like(rhs, dtype=np.float64)
        residual = rhs.astype(np.float64)
        goal = self.rtol * np.linalg.norm(residual)
        if goal == 0.0:
            return x
        z = self._preconditioner @ residual
        direction, rz = z.copy(), residual @ z
        for _ in range(self.max_iterations):
            image = self._matrix @ direction
            curvature = direction @ image
            if curvature <= 0:
                raise IndefiniteError("negative curvature: the matrix is not positive definite")
            step = rz / curvature
            x += step * direction
            residual -= step * image
            if np.linalg.norm(residual) <= goal:
                return x
            z = self._preconditioner @ residual
            rz, previous = residual @ z, rz
            direction = z + (rz / previous) * direction
        reached = np.linalg.norm(residual) / np.linalg.norm(rhs)
        raise RuntimeError(
            f"multigrid reached a residual of {reached:.1e}, not {self.rtol:.1e}, in "
            f"{self.max_iterations} iterations; use solver=pardiso, or raise rtol"
        )

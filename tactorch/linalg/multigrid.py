"""Conjugate gradients with smoothed-aggregation multigrid, for the largest meshes.

The near-nullspace (the six rigid-body modes in elasticity) makes the convergence of the
aggregation independent of the mesh size. Reference: Vanek, Mandel and Brezina (1996).
"""

from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp

from tactorch.config import option
from tactorch.linalg.solver import IterativeSolver, SolverOptions


class MultigridSolver(IterativeSolver):
    """Conjugate gradients with multigrid; the aggregates of the first matrix are reused."""

    _aggregates: list[sp.csr_matrix] | None = None

    def _factor(self, values: np.ndarray) -> bool:
        import pyamg

        self._matrix = full = self.pattern.full(values)
        if np.any(full.diagonal() <= 0):
            return False
        block = full.tobsr((3, 3)) if self.pattern.size % 3 == 0 else full
        options: dict[str, Any] = {}
        if self.near_nullspace is not None:
            options["B"] = self._constrained_modes(self.near_nullspace)
        if self._aggregates:
            options["aggregate"] = [("predefined", {"AggOp": a}) for a in self._aggregates]
            options["max_levels"] = len(self._aggregates) + 1
        hierarchy = pyamg.smoothed_aggregation_solver(
            block, keep=True, max_coarse=300, coarse_solver="splu", symmetry="symmetric", **options
        )
        if self._aggregates is None:
            self._aggregates = [level.AggOp for level in hierarchy.levels[:-1]]
        self._preconditioner = hierarchy.aspreconditioner(cycle="V")
        return True

    def _constrained_modes(self, modes: np.ndarray) -> np.ndarray:
        """Modes with the fixed unknowns (rows with a diagonal entry only) set to zero."""
        sums = np.asarray(abs(self._matrix).sum(axis=1)).ravel()
        fixed = sums == np.abs(self._matrix.diagonal())
        return np.where(fixed[:, None], 0.0, modes)

    def _solve(self, rhs: np.ndarray) -> np.ndarray:
        if rhs.ndim > 1:
            return np.stack([self._solve(np.ascontiguousarray(b)) for b in rhs.T], axis=1)
        return self._iterate(
            self._matrix.__matmul__, lambda r: self._preconditioner @ r, rhs.astype(np.float64)
        )


@dataclass(frozen=True)
class Multigrid(SolverOptions):
    """Conjugate gradients with algebraic multigrid, for the largest meshes."""

    solver = MultigridSolver
    requires: ClassVar[str] = "pyamg"

    rtol: float = option(1e-12, "Relative residual at which a solve ends", gt=0, lt=1)
    max_iterations: int = option(500, "Limit of iterations in one solve", ge=1)

    @staticmethod
    def available() -> bool:
        return find_spec("pyamg") is not None

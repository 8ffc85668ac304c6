"""Conjugate gradients with smoothed-aggregation multigrid, for the largest meshes.

The near-nullspace (the six rigid-body modes in elasticity) makes the convergence of the
aggregation independent of the mesh size. Reference: Vanek, Mandel and Brezina (1996).
"""

from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float

from tactorch.config import option
from tactorch.linalg.pattern import SymmetricPattern
from tactorch.linalg.solver import IterativeSolver, SolverOptions, Status


@dataclass(frozen=True)
class Multigrid(SolverOptions):
    """Conjugate gradients with algebraic multigrid, for the largest meshes."""

    requires: ClassVar[str] = "pyamg"

    rtol: float = option(1e-12, "Relative residual at which a solve ends", gt=0, lt=1)
    max_iterations: int = option(500, "Limit of iterations in one solve", ge=1)

    @staticmethod
    def available() -> bool:
        """Return whether pyamg is installed."""
        return find_spec("pyamg") is not None

    def analyse(
        self,
        pattern: SymmetricPattern,
        near_nullspace: Float[np.ndarray, "size modes"] | None = None,
        single_precision: bool = False,
    ) -> "MultigridSolver":
        """See `SolverOptions.analyse`."""
        return MultigridSolver(self, pattern, near_nullspace)


class MultigridSolver(IterativeSolver):
    """Iterative solver; see `tactorch.linalg.Solver`.

    Args:
        options: Settings.
        pattern: The matrix pattern, three unknowns a node.
        near_nullspace: Columns that the operator nearly annihilates, (size, modes).
    """

    def __init__(
        self,
        options: Multigrid,
        pattern: SymmetricPattern,
        near_nullspace: Float[np.ndarray, "size modes"] | None = None,
    ) -> None:
        self.options = options
        self.pattern = pattern
        self._modes = near_nullspace
        self._aggregates: list[sp.csr_matrix] | None = None
        self._matrix: sp.csr_matrix | None = None
        self._preconditioner: Any = None

    def factor(self, values: Float[np.ndarray, " nnz"]) -> Status:
        """Build the hierarchy; the aggregates of the first matrix are reused for later ones."""
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
            options["B"] = self._constrained_modes(full)
        if self._aggregates:
            options["aggregate"] = [("predefined", {"AggOp": a}) for a in self._aggregates]
            options["max_levels"] = len(self._aggregates) + 1
        hierarchy = pyamg.smoothed_aggregation_solver(block, keep=True, **options)
        if self._aggregates is None:
            self._aggregates = [level.AggOp for level in hierarchy.levels[:-1]]
        self._preconditioner = hierarchy.aspreconditioner(cycle="V")
        return Status.OK

    def _constrained_modes(self, full: sp.csr_matrix) -> np.ndarray:
        """Modes with the fixed unknowns (rows with a diagonal entry only) set to zero."""
        modes = np.array(self._modes, dtype=np.float64)
        sums = np.asarray(abs(full).sum(axis=1)).ravel()
        modes[sums == np.abs(full.diagonal())] = 0.0
        return modes

    def solve(self, rhs: Float[np.ndarray, "size *k"]) -> Float[np.ndarray, "size *k"]:
        """Return the solution, column by column.

        Raises:
            ConvergenceError: The residual is not reached within the limit of iterations.
            IndefiniteError: Negative curvature is met.
        """
        if self._matrix is None:
            raise RuntimeError("factor the matrix before solving")
        if rhs.ndim > 1:
            return np.stack([self.solve(np.ascontiguousarray(b)) for b in rhs.T], axis=1)
        return self._iterate(
            self._matrix.__matmul__, lambda r: self._preconditioner @ r, rhs.astype(np.float64)
        )

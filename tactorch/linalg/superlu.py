"""SciPy's SuperLU: the direct solver that is always installed."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from tactorch.linalg.solver import Solver, SolverOptions


class SuperLUSolver(Solver):
    """Sparse LU without pivoting, so that the signs of the pivots show definiteness.

    SciPy cannot reuse a symbolic factorisation; the fill-reducing order, which is the expensive
    part of the analysis, is computed once and applied to every later matrix.
    """

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        laplacian = self.pattern.full(np.full(self.pattern.nnz, -1.0))
        laplacian.setdiag(np.diff(laplacian.indptr) + 1.0)
        self._order = np.argsort(symmetric_lu(laplacian, "MMD_AT_PLUS_A").perm_c)

    def _factor(self, values: np.ndarray) -> bool:
        matrix = self.pattern.full(values)[self._order][:, self._order]
        try:
            self._lu = symmetric_lu(matrix, "NATURAL")
        except RuntimeError:  # SciPy reports an exactly singular matrix so
            return False
        return bool(np.all(self._lu.U.diagonal() > 0))

    def _solve(self, rhs: np.ndarray) -> np.ndarray:
        out = np.empty_like(rhs, dtype=np.float64)
        out[self._order] = self._lu.solve(np.ascontiguousarray(rhs[self._order], dtype=np.float64))
        return out


@dataclass(frozen=True)
class SuperLU(SolverOptions):
    """SciPy's direct solver, installed everywhere."""

    solver = SuperLUSolver


def symmetric_lu(matrix: sp.spmatrix | sp.sparray, order: str) -> spla.SuperLU:
    """Factor a symmetric matrix with its pivots on the diagonal, in an order of SuperLU's names."""
    options: dict[str, Any] = {"diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
    return spla.splu(sp.csc_matrix(matrix), permc_spec=order, **options)

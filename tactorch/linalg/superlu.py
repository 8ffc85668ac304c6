"""SciPy's SuperLU: the direct solver that is always installed."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla
from jaxtyping import Float

from tactorch.linalg.pattern import SymmetricPattern
from tactorch.linalg.solver import SolverOptions, Status


@dataclass(frozen=True)
class SuperLU(SolverOptions):
    """SciPy's direct solver, installed everywhere."""

    def analyse(
        self,
        pattern: SymmetricPattern,
        near_nullspace: Float[np.ndarray, "size modes"] | None = None,
        single_precision: bool = False,
    ) -> "SuperLUSolver":
        """See `SolverOptions.analyse`."""
        return SuperLUSolver(pattern)


class SuperLUSolver:
    """Sparse LU without pivoting, so that the signs of the pivots show definiteness.

    SciPy cannot reuse a symbolic factorisation; the fill-reducing order, which is the expensive
    part of the analysis, is computed once and applied to every later matrix.

    Args:
        pattern: The matrix pattern.
    """

    direct = True
    single_precision = False

    def __init__(self, pattern: SymmetricPattern) -> None:
        self.pattern = pattern
        laplacian = pattern.full(np.full(pattern.nnz, -1.0))
        laplacian.setdiag(np.diff(laplacian.indptr) + 1.0)
        order = _splu(laplacian.tocsc(), "MMD_AT_PLUS_A").perm_c
        self._order = np.argsort(order)
        self._lu: spla.SuperLU | None = None

    def factor(self, values: Float[np.ndarray, " nnz"]) -> Status:
        """Factor the matrix; a non-positive or vanishing pivot means an indefinite matrix."""
        if not np.all(np.isfinite(values)):
            return Status.INDEFINITE
        matrix = self.pattern.full(values)[self._order][:, self._order]
        try:
            self._lu = _splu(matrix.tocsc(), "NATURAL")
        except RuntimeError:  # SciPy reports an exactly singular matrix so
            return Status.INDEFINITE
        pivots = self._lu.U.diagonal()
        return Status.OK if np.all(pivots > 0) else Status.INDEFINITE

    def solve(self, rhs: Float[np.ndarray, "size *k"]) -> Float[np.ndarray, "size *k"]:
        """Return the solution for all columns of `rhs`."""
        if self._lu is None:
            raise RuntimeError("factor the matrix before solving")
        out = np.empty_like(rhs, dtype=np.float64)
        out[self._order] = self._lu.solve(np.ascontiguousarray(rhs[self._order], dtype=np.float64))
        return out


def _splu(matrix: sp.csc_matrix, order: str) -> spla.SuperLU:
    return spla.splu(
        matrix, permc_spec=order, diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )

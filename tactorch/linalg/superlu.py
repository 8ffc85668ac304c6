"""SciPy's SuperLU: the direct solver that is always installed, and selected inversion."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, no_type_check

import numba
import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla
from jaxtyping import Float, Int

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
        lu: Any = _definite_lu(laplacian, "MMD_AT_PLUS_A")
        self._order = np.argsort(lu.perm_c)

    def _factor(self, values: np.ndarray) -> bool:
        matrix = self.pattern.full(values)[self._order][:, self._order]
        self._lu: Any = _definite_lu(matrix, "NATURAL")
        return self._lu is not None

    def _solve(self, rhs: np.ndarray, _rtol: float) -> np.ndarray:
        out = np.empty_like(rhs, dtype=np.float64)
        out[self._order] = self._lu.solve(np.ascontiguousarray(rhs[self._order], dtype=np.float64))
        return out


@dataclass(frozen=True)
class SuperLU(SolverOptions):
    """SciPy's direct solver, installed everywhere."""

    solver = SuperLUSolver


def _definite_lu(matrix: sp.spmatrix | sp.sparray, order: str) -> spla.SuperLU | None:
    """Factor a symmetric matrix, in an order of SuperLU's names; None if it is not definite."""
    options: dict[str, Any] = {"diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
    try:
        lu = spla.splu(sp.csc_matrix(matrix), permc_spec=order, **options)
    except RuntimeError:  # SciPy reports an exactly singular matrix so
        return None
    # Rows and columns differ in order if a pivot on the diagonal vanished.
    return lu if np.all(lu.U.diagonal() > 0) and np.array_equal(lu.perm_r, lu.perm_c) else None


@dataclass(frozen=True, eq=False)
class SparseFactor:
    """Factorisation A = L D L^T of a permuted sparse matrix, L with unit diagonal.

    The diagonal of the inverse follows without solves: its entries on the factor's pattern are
    computed recursively from the last column (Takahashi, Fagan and Chin, 1973).
    """

    below: sp.csc_matrix  # L without its diagonal; with entries that vanish by cancellation
    pivots: Float[np.ndarray, " n"]  # diagonal of D
    place: Int[np.ndarray, " n"]  # position of each unknown in the permuted order
    lu: spla.SuperLU  # SciPy's factorisation, for solves

    @staticmethod
    def of(matrix: sp.spmatrix | sp.sparray) -> "SparseFactor | None":
        """Factor a matrix; None if it is not positive definite."""
        lu = _definite_lu(matrix, "MMD_AT_PLUS_A")
        if lu is None:
            return None
        place = lu.perm_c.astype(np.int64)
        order = np.argsort(place)
        below = _below(sp.csr_matrix(matrix)[order][:, order], sp.csc_matrix(lu.L))
        return SparseFactor(below, lu.U.diagonal(), place, lu)

    def solve(self, rhs: Float[np.ndarray, "n *k"]) -> Float[np.ndarray, "n *k"]:
        """Return the solution of A x = rhs, one or many columns."""
        return self.lu.solve(np.ascontiguousarray(rhs))

    @cached_property
    def _upper(self) -> sp.csr_matrix:
        return sp.csr_matrix((self.below + sp.eye(len(self.pivots), format="csc")).T)

    def correlated(self, noise: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n k"]:
        """Return samples of covariance A^-1 from columns of standard normal numbers."""
        scaled = noise / np.sqrt(self.pivots)[:, None]
        sample = spla.spsolve_triangular(self._upper, scaled, lower=False, unit_diagonal=True)
        return sample[self.place]

    @cached_property
    def inverse_diagonal(self) -> Float[np.ndarray, " n"]:
        """Diagonal of A^-1."""
        out = np.empty(len(self.pivots))
        below = self.below
        _selected_inverse(below.indptr, below.indices, below.data, self.pivots, out)
        return out[self.place]


def _below(permuted: sp.csr_matrix, lower: sp.csc_matrix) -> sp.csc_matrix:
    """Return L below the diagonal on its full pattern, of which SciPy omits zeros."""
    lower.sort_indices()
    rows, columns = (permuted.indptr, permuted.indices), (lower.indptr, lower.indices, lower.data)
    size = permuted.shape[0]
    starts = np.zeros(size + 1, dtype=np.int64)
    empty = np.empty(0)
    _fill(*rows, *columns, starts[1:], empty.astype(np.int32), empty)
    ends = np.cumsum(starts)
    indices, values = np.empty(ends[-1], dtype=np.int32), np.empty(ends[-1])
    _fill(*rows, *columns, ends[:-1].copy(), indices, values)
    return sp.csc_matrix((values, indices, ends), shape=(size, size))


@no_type_check
@numba.njit(nogil=True, cache=True)
def _fill(row_ends, row_indices, lower_ends, lower_indices, lower_values, ends, indices, values):
    """Count the entries of L per column if `indices` is empty, or write them; advances `ends`.

    Row i of L has an entry in column j if j is an ancestor of an entry of A's row in the
    elimination tree (Liu, 1990).
    """
    n = len(ends)
    parent = np.full(n, -1, dtype=np.int64)
    visited = np.full(n, -1, dtype=np.int64)
    upcoming = lower_ends[:-1] + 1  # the diagonal is first
    for i in range(n):
        visited[i] = i
        for q in range(row_ends[i], row_ends[i + 1]):
            j = row_indices[q]
            while j < i and visited[j] != i:
                visited[j] = i
                if len(indices) > 0:
                    indices[ends[j]] = i
                    values[ends[j]] = 0.0
                    if upcoming[j] < lower_ends[j + 1] and lower_indices[upcoming[j]] == i:
                        values[ends[j]] = lower_values[upcoming[j]]
                        upcoming[j] += 1
                ends[j] += 1
                if parent[j] < 0:
                    parent[j] = i
                j = parent[j]


@no_type_check
@numba.njit(nogil=True, cache=True)
def _selected_inverse(indptr, indices, values, pivots, diagonal):
    """Z = D^-1 L^-1 + (1 - L^T) Z, on the pattern of L, column by column from the last."""
    n = len(pivots)
    entries = np.zeros(len(values))  # Z below the diagonal
    slot = np.full(n, -1, dtype=np.int64)  # position of a row in the current column
    for j in range(n - 1, -1, -1):
        begin, end = indptr[j], indptr[j + 1]
        for t in range(begin, end):
            slot[indices[t]] = t
        for t in range(begin, end):
            k, share = indices[t], values[t]
            inner = share * diagonal[k]
            for q in range(indptr[k], indptr[k + 1]):
                other = slot[indices[q]]
                if other >= 0:  # Z is symmetric
                    entries[other] -= share * entries[q]
                    inner += values[other] * entries[q]
            entries[t] -= inner
        total = 1.0 / pivots[j]
        for t in range(begin, end):
            total -= values[t] * entries[t]
            slot[indices[t]] = -1
        diagonal[j] = total

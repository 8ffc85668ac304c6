"""The sparsity pattern of a symmetric matrix, stored as its upper triangle."""

from dataclasses import dataclass
from functools import cached_property
from typing import no_type_check

import numba
import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int


@dataclass(frozen=True, eq=False)
class SymmetricPattern:
    """Upper triangle in compressed rows; the first entry of each row is the diagonal.

    Attributes:
        indptr: Start of each row, (size + 1,).
        indices: Column of each entry, sorted within a row, (nnz,).
    """

    indptr: Int[np.ndarray, " rows_plus_one"]
    indices: Int[np.ndarray, " nnz"]

    @staticmethod
    def from_pairs(
        size: int, rows: Int[np.ndarray, "..."], cols: Int[np.ndarray, "..."]
    ) -> "SymmetricPattern":
        """Build the pattern of the couplings `(row, col)` of either triangle and the diagonal."""
        every = np.arange(size)
        low = np.concatenate([np.minimum(rows, cols).ravel(), every])
        high = np.concatenate([np.maximum(rows, cols).ravel(), every])
        upper = sp.csr_matrix((np.ones(len(low), dtype=bool), (low, high)), shape=(size, size))
        return SymmetricPattern(upper.indptr.astype(np.int32), upper.indices.astype(np.int32))

    def blocks(self, size: int) -> "SymmetricPattern":
        """Return the pattern in which each unknown is a block of `size` unknowns."""
        counts = np.diff(self.indptr)
        wide = (size * self.indices[:, None] + np.arange(size, dtype=np.int32)).ravel()
        # Row r of a block begins at its diagonal, r entries after that of the first row.
        offsets = np.arange(size, dtype=np.int32)
        starts = (size * self.indptr[:-1, None] + offsets).ravel()
        lengths = (size * counts[:, None] - offsets).ravel()
        indptr = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int32)
        entries = np.arange(indptr[-1], dtype=np.int32) + np.repeat(starts - indptr[:-1], lengths)
        return SymmetricPattern(indptr, wide[entries])

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return len(self.indptr) - 1

    @property
    def nnz(self) -> int:
        """Number of stored entries."""
        return len(self.indices)

    @cached_property
    def rows(self) -> Int[np.ndarray, " nnz"]:
        """Row of each entry."""
        return np.repeat(np.arange(self.size, dtype=np.int32), np.diff(self.indptr))

    @property
    def diagonal(self) -> Int[np.ndarray, " size"]:
        """Index of each diagonal entry in the stored values."""
        return self.indptr[:-1]

    def slots(
        self, rows: Int[np.ndarray, "*shape"], cols: Int[np.ndarray, "*shape"]
    ) -> Int[np.ndarray, "*shape"]:
        """Return the index in the stored values of each coupling, given in either triangle."""
        numbers = np.arange(self.nnz, dtype=np.int32)
        entries = sp.csr_matrix((numbers, self.indices, self.indptr), shape=(self.size,) * 2)
        found = entries[np.minimum(rows, cols).ravel(), np.maximum(rows, cols).ravel()]
        return np.asarray(found).reshape(rows.shape)

    @cached_property
    def _mirror(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Full pattern (indptr, indices), and the index of the stored value of each entry."""
        numbers = np.arange(1, self.nnz + 1, dtype=np.int32)  # zeros would not be stored
        upper = sp.csr_matrix((numbers, self.indices, self.indptr), shape=(self.size,) * 2)
        both = upper + sp.triu(upper, 1, format="csr").T
        return both.indptr, both.indices, both.data - 1

    def full(self, values: Float[np.ndarray, " nnz"]) -> sp.csr_matrix:
        """Return both triangles as a SciPy matrix."""
        indptr, indices, source = self._mirror
        return sp.csr_matrix((values[source], indices, indptr), shape=(self.size,) * 2)

    def product(
        self, values: Float[np.ndarray, " nnz"], x: Float[np.ndarray, "size *k"]
    ) -> Float[np.ndarray, "size *k"]:
        """Return the product of the symmetric matrix with `x`."""
        if x.ndim == 1:
            out = np.zeros(self.size)
            symmetric_product(self.indptr, self.indices, values, x, out)
            return out
        upper = sp.csr_matrix((values, self.indices, self.indptr), shape=(self.size,) * 2)
        return upper @ x + upper.T @ x - (values[self.diagonal] * x.T).T

    def apply_dirichlet(
        self, values: Float[np.ndarray, " nnz"], fixed: Bool[np.ndarray, " size"]
    ) -> Float[np.ndarray, " nnz"]:
        """Return values whose rows and columns of fixed unknowns have a diagonal entry only."""
        if not fixed.any():
            return values
        out = np.empty_like(values)
        scale = float(np.abs(values[self.diagonal]).mean())
        _apply_dirichlet(self.indptr, self.indices, values, fixed, scale, out)
        return out


@no_type_check
@numba.njit(nogil=True, cache=True)
def symmetric_product(indptr, indices, values, x, out):
    """Add A x to `out`; the rows of the upper triangle of A begin with the diagonal."""
    for i in range(indptr.shape[0] - 1):
        begin = indptr[i]
        total = values[begin] * x[i]
        for k in range(begin + 1, indptr[i + 1]):
            j = indices[k]
            total += values[k] * x[j]
            out[j] += values[k] * x[i]
        out[i] += total


@no_type_check
@numba.njit(nogil=True, cache=True)
def _apply_dirichlet(indptr, indices, values, fixed, scale, out):
    """Copy `values`, with `scale` on the diagonal of fixed unknowns and zeros in their rows."""
    for i in range(indptr.shape[0] - 1):
        for k in range(indptr[i], indptr[i + 1]):
            out[k] = 0.0 if fixed[i] or fixed[indices[k]] else values[k]
        if fixed[i]:
            out[indptr[i]] = scale

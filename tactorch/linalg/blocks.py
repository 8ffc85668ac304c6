"""Symmetric sparse matrices of 3 x 3 blocks, one for each pair of nodes, in single precision.

SciPy's product of such matrices does not unroll the blocks, and takes eight times as long.
"""

from dataclasses import dataclass
from typing import no_type_check

import numba
import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from tactorch.linalg.pattern import SymmetricPattern

Real = np.float32  # the time of a product is that of reading the matrix
SIZE = 3  # unknowns of a node


@dataclass(frozen=True, eq=False)
class BlockMatrix:
    """A symmetric sparse matrix of 3 x 3 blocks, of which those of the upper triangle are stored.

    Each row of blocks begins with its diagonal block.
    """

    indptr: Int[np.ndarray, " rows_1"]  # begin of each row, and the end of the last
    indices: Int[np.ndarray, " blocks"]  # columns
    values: Float[np.ndarray, " entries"]  # of the blocks, row by row

    @staticmethod
    def of(matrix: sp.bsr_matrix) -> "BlockMatrix":
        """Return a symmetric SciPy matrix of sorted 3 x 3 blocks, or of its upper triangle."""
        rows = np.repeat(np.arange(len(matrix.indptr) - 1), np.diff(matrix.indptr))
        upper = matrix.indices >= rows
        counts = np.bincount(rows[upper], minlength=len(matrix.indptr) - 1)
        indptr = np.concatenate([[0], np.cumsum(counts)]).astype(matrix.indptr.dtype)
        chosen = slice(None) if upper.all() else upper
        values = matrix.data[chosen].astype(Real).ravel()
        return BlockMatrix(indptr, matrix.indices[chosen], values)

    def __matmul__(self, x: Float[np.ndarray, " size"]) -> Float[np.ndarray, " size"]:
        """Return the product with a vector in single precision."""
        out = np.zeros(SIZE * (len(self.indptr) - 1), dtype=Real)
        _product(self.indptr, self.indices, self.values, np.asarray(x, dtype=Real), out)
        return out


def upper_blocks(pattern: SymmetricPattern, values: Float[np.ndarray, " nnz"]) -> sp.bsr_matrix:
    """Return the blocks of the upper triangle of a matrix, sorted; those on the diagonal whole.

    They are of single unknowns where the matrix is not of nodes.
    """
    size = SIZE if pattern.size % SIZE == 0 else 1
    upper = sp.csr_matrix((values, pattern.indices, pattern.indptr), shape=(pattern.size,) * 2)
    blocks = upper.tobsr((size, size))
    blocks.sort_indices()
    begins = blocks.indptr[:-1]
    diagonal = blocks.data[begins]
    blocks.data[begins] += np.tril(diagonal.swapaxes(1, 2), -1)
    return blocks


@no_type_check
@numba.njit(nogil=True, cache=True, fastmath={"reassoc", "contract"})
def _product(indptr, indices, values, x, out):
    """Add the product to `out`; each block above the diagonal is read once for both triangles."""
    for i in range(indptr.shape[0] - 1):
        m, i3 = 9 * indptr[i], 3 * i
        y0, y1, y2 = x[i3], x[i3 + 1], x[i3 + 2]
        a = values[m] * y0 + values[m + 1] * y1 + values[m + 2] * y2
        b = values[m + 3] * y0 + values[m + 4] * y1 + values[m + 5] * y2
        c = values[m + 6] * y0 + values[m + 7] * y1 + values[m + 8] * y2
        for k in range(indptr[i] + 1, indptr[i + 1]):
            m, j = 9 * k, 3 * indices[k]
            d0, d1, d2 = values[m], values[m + 1], values[m + 2]
            d3, d4, d5 = values[m + 3], values[m + 4], values[m + 5]
            d6, d7, d8 = values[m + 6], values[m + 7], values[m + 8]
            x0, x1, x2 = x[j], x[j + 1], x[j + 2]
            a += d0 * x0 + d1 * x1 + d2 * x2
            b += d3 * x0 + d4 * x1 + d5 * x2
            c += d6 * x0 + d7 * x1 + d8 * x2
            out[j] += d0 * y0 + d3 * y1 + d6 * y2
            out[j + 1] += d1 * y0 + d4 * y1 + d7 * y2
            out[j + 2] += d2 * y0 + d5 * y1 + d8 * y2
        out[i3] += a
        out[i3 + 1] += b
        out[i3 + 2] += c

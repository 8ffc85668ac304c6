"""Dense vectors and matrices, without the threads of NumPy's and SciPy's BLAS.

After a call these threads keep spinning for about 25 ms, in which a concurrent solve by PARDISO
takes five to ten times as long.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import torch
from jaxtyping import Float
from torch import Tensor


def dot(a: Float[np.ndarray, " n"], b: Float[np.ndarray, " n"]) -> float:
    """Return the scalar product of two vectors."""
    if a.shape != b.shape:
        raise ValueError(f"vectors of {a.shape} and {b.shape} have no scalar product")
    return float(np.einsum("i,i", a, b))


def column_rank(columns: Float[np.ndarray, "n k"], tolerance: float) -> int:
    """Return the rank of a matrix of few columns, by Gram-Schmidt with pivoting.

    Remainders whose norm is below `tolerance` count as zero.
    """
    rest = columns.copy()
    for rank in range(rest.shape[1]):
        sizes = np.sqrt(np.einsum("ij,ij->j", rest, rest))
        largest = int(sizes.argmax())
        if not sizes[largest] > tolerance:
            return rank
        unit = rest[:, largest] / sizes[largest]
        rest -= unit[:, None] * np.einsum("i,ij->j", unit, rest)
    return rest.shape[1]


@dataclass(frozen=True, eq=False)
class DenseCholesky:
    """Cholesky factorisation of a dense symmetric positive definite matrix."""

    lower: Float[Tensor, "n n"]

    @staticmethod
    def of(
        matrix: Float[np.ndarray, "n n"], added: sp.spmatrix | sp.sparray | None = None
    ) -> "DenseCholesky | None":
        """Return the factorisation, or None if the matrix is not positive definite.

        A sparse matrix `added` is added to it, in place.
        """
        if added is not None:
            coo = added.tocoo()
            np.add.at(matrix, (coo.row, coo.col), coo.data)
        lower, info = torch.linalg.cholesky_ex(torch.from_numpy(matrix))
        return None if int(info) else DenseCholesky(lower)

    def solve(self, rhs: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the solution for one right-hand side."""
        return torch.cholesky_solve(torch.from_numpy(rhs)[:, None], self.lower)[:, 0].numpy()

    def inverse(self) -> Float[np.ndarray, "n n"]:
        """Return the inverse of the matrix."""
        return torch.cholesky_inverse(self.lower).numpy()

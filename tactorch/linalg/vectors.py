"""Scalar products that leave the other core alone.

NumPy's BLAS does these in threads that go on spinning for some 25 ms, and whatever MKL does
meanwhile (a solve by PARDISO, say) takes five times as long.
"""

from math import sqrt

import numpy as np
from jaxtyping import Float

from tactorch.linalg import kernels


def dot(a: Float[np.ndarray, " n"], b: Float[np.ndarray, " n"]) -> float:
    """Return the scalar product.

    Raises:
        ValueError: the lengths differ.
    """
    if a.shape != b.shape:
        raise ValueError(f"vectors of {a.shape} and {b.shape} have no scalar product")
    return float(kernels.dot(a, b))


def norm(a: Float[np.ndarray, " n"]) -> float:
    """Return the Euclidean norm."""
    return sqrt(kernels.dot(a, a))


def column_rank(columns: Float[np.ndarray, "n k"], tolerance: float) -> int:
    """Return the rank, by Gram and Schmidt with pivoting."""
    left = columns.copy()
    for rank in range(left.shape[1]):
        sizes = np.sqrt(np.einsum("ij,ij->j", left, left))
        largest = int(sizes.argmax())
        if not sizes[largest] > tolerance:
            return rank
        one = left[:, largest] / sizes[largest]
        left -= one[:, None] * np.einsum("i,ij->j", one, left)
    return left.shape[1]

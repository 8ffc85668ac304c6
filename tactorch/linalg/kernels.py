"""Compiled inner loops of the sparse algebra."""

from typing import no_type_check

import numba


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
def apply_dirichlet(indptr, indices, values, fixed, scale, out):
    """Copy `values`, with `scale` on the diagonal of fixed unknowns and zeros in their rows."""
    for i in range(indptr.shape[0] - 1):
        for k in range(indptr[i], indptr[i + 1]):
            out[k] = 0.0 if fixed[i] or fixed[indices[k]] else values[k]
        if fixed[i]:
            out[indptr[i]] = scale


@no_type_check
@numba.njit(nogil=True, cache=True, fastmath={"reassoc", "contract"})
def dot(a, b):
    """Scalar product of two vectors."""
    total = 0.0
    for i in range(a.shape[0]):
        total += a[i] * b[i]
    return total

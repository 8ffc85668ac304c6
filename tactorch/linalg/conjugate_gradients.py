"""Preconditioned conjugate gradients: the one iteration that all of tactorch uses.

It solves for one vector or for a batch of columns, on NumPy arrays and torch tensors, and stops
at directions of negative curvature. References: Hestenes and Stiefel (1952); Steihaug (1983).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import torch

from tactorch.linalg.dense import dot

Array = Any  # a NumPy array or a torch tensor, of shape (size,) or (size, columns)


class CGResult(NamedTuple):
    """Outcome of conjugate gradients."""

    solution: Array  # last iterate
    image: Array  # product of the matrix with the solution
    iterations: int  # number of products with the matrix
    converged: bool  # whether every column reached the tolerance
    negative_curvature: bool  # whether a column met it, of the matrix or of the preconditioner


def conjugate_gradients(
    product: Callable[[Array], Array],
    precondition: Callable[[Array], Array],
    rhs: Array,
    *,
    rtol: float,
    max_iterations: int,
    preconditioned_norm: bool = False,
    orthogonalize: bool = False,
) -> CGResult:
    """Solve A x = rhs for a symmetric positive definite A.

    Each iterate lowers x.A x / 2 - x.rhs further, so that a truncated solution is still a descent
    step. A column that meets a direction of negative curvature keeps its last iterate or, at the
    first iteration, takes the preconditioned right-hand side; both are descent directions.

    Args:
        product: Product with A.
        precondition: Product with a symmetric positive definite approximation of the inverse of A.
        rhs: Right-hand side, one vector (size,) or a batch of columns (size, columns).
        rtol: Residual at convergence, relative to `rhs`.
        max_iterations: Limit of the number of products with A.
        preconditioned_norm: Whether residuals are measured in the norm of the preconditioner
            instead of the Euclidean one, which takes one product with the preconditioner more.
        orthogonalize: Whether each residual is orthogonalised against all former ones. This keeps
            the convergence, and makes it reproducible, at the memory of two vectors an iteration.

    Returns:
        The solution, and how the iteration ended.
    """
    xp = torch if isinstance(rhs, torch.Tensor) else np
    x, image = xp.zeros_like(rhs), xp.zeros_like(rhs)
    residual, z = rhs, precondition(rhs)
    rz = _dot(residual, z)
    size = rz if preconditioned_norm else _dot(residual, residual)
    goal = rtol**2 * size
    active = size > goal
    negative = active & ~(rz > 0.0)
    active = active & ~negative
    direction, former, iteration = z, [], 0
    while iteration < max_iterations and bool(active.any()):
        along = product(direction)
        curvature = _dot(direction, along)
        ended = active & ~(curvature > 0.0)
        negative, active = negative | ended, active & ~ended
        if iteration == 0 and bool(ended.any()):
            x, image = xp.where(ended, direction, x), xp.where(ended, along, image)
        length = xp.where(active, rz / xp.where(active, curvature, 1.0), 0.0)
        x, image = x + length * direction, image + length * along
        if orthogonalize:
            former.append((residual, z, rz))
        residual = residual - length * along
        for old, old_z, old_rz in former:
            residual = residual - (_dot(old_z, residual) / old_rz) * old
        iteration += 1
        if not preconditioned_norm:
            size = _dot(residual, residual)
            active = active & (size > goal)
            if not bool(active.any()):
                break
        z, previous = precondition(residual), rz
        rz = _dot(residual, z)
        if preconditioned_norm:
            size = rz
        active = active & (size > goal)
        negative = negative | (active & ~(rz > 0.0))
        active = active & ~negative
        direction = z + xp.where(active, rz / xp.where(active, previous, 1.0), 0.0) * direction
    converged = bool((size <= goal).all()) and not bool(negative.any())
    return CGResult(x, image, iteration, converged, bool(negative.any()))


def _dot(a: Array, b: Array) -> Array:
    """Scalar products of the columns; without BLAS for vectors, see `tactorch.linalg.dense`."""
    if isinstance(a, np.ndarray) and a.ndim == 1:
        return np.float64(dot(a, b))
    return (a * b).sum(0)

"""Solving with the factorisation of a nearby matrix."""

import numpy as np
from jaxtyping import Float

from tactorch.linalg.pattern import SymmetricPattern
from tactorch.linalg.protocol import Factored
from tactorch.linalg.vectors import dot, norm

# A factorisation costs ten to twenty-five solves, on small meshes as on large ones.
_MAX_ITERATIONS = 10


def lagged_solve(
    pattern: SymmetricPattern,
    values: Float[np.ndarray, " nnz"],
    solver: Factored,
    rhs: Float[np.ndarray, " size"],
    rtol: float,
) -> Float[np.ndarray, " size"] | None:
    """Solve by conjugate gradients, preconditioned with an older factorisation.

    Args:
        pattern: Sparsity of the matrix.
        values: Its present values.
        solver: Factored with values from a few Newton steps ago.
        rhs: Right-hand side.
        rtol: Residual, relative to `rhs`, that suffices.

    Returns:
        The solution, or None where factoring anew is the better way: the matrix has changed too
        much, or is not positive definite.
    """
    x = np.zeros_like(rhs)
    residual = rhs.copy()
    goal = rtol * norm(rhs)
    direction, previous = np.zeros_like(rhs), 1.0
    for iteration in range(_MAX_ITERATIONS):
        z = solver.solve(residual)
        rz = dot(residual, z)
        direction = z if iteration == 0 else z + (rz / previous) * direction
        image = pattern.product(values, direction)
        curvature = dot(direction, image)
        if not (curvature > 0.0 and rz > 0.0):
            return None
        step, previous = rz / curvature, rz
        x += step * direction
        residual -= step * image
        if norm(residual) <= goal:
            return x
    return None

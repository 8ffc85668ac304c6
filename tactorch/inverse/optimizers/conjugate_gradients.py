"""Conjugate gradients for one step, cut short where it is good enough or the model bends down."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tactorch.linalg import dot

Linear = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class CGResult:
    """A step, and what the matrix makes of it.

    Attributes:
        step: The step.
        image: The matrix times the step.
        iterations: Products with the matrix.
        bent: Whether a direction of negative curvature was met.
    """

    step: Float[np.ndarray, " size"]
    image: Float[np.ndarray, " size"]
    iterations: int
    bent: bool


def truncated(
    product: Linear,
    precondition: Linear,
    gradient: Float[np.ndarray, " size"],
    rtol: float,
    max_iterations: int,
) -> CGResult:
    """Solve H step = -gradient to `rtol` in the preconditioner's norm (Steihaug, 1983).

    Each iterate lowers the quadratic model further, so that wherever it is cut short the step is
    one of descent. On negative curvature the step so far is taken, or, where there is none, the
    preconditioned steepest descent. Residuals are made orthogonal to all former ones: round-off
    costs iterations else, and grows so far that a resumed run would end elsewhere.
    """
    step, image = np.zeros_like(gradient), np.zeros_like(gradient)
    residual = -gradient
    z = precondition(residual)
    size = first = dot(residual, z)
    direction = z
    past: list[tuple[np.ndarray, np.ndarray, float]] = []
    for iteration in range(max_iterations):
        if size <= rtol**2 * first or size <= 0.0:
            return CGResult(step, image, iteration, False)
        along = product(direction)
        curvature = dot(direction, along)
        if curvature <= 0.0:
            if iteration == 0:
                step, image = direction, along
            return CGResult(step, image, iteration + 1, True)
        length = size / curvature
        step = step + length * direction
        image = image + length * along
        past.append((residual, z, size))
        residual = residual - length * along
        for old, image_of_old, square in past:
            residual = residual - (dot(image_of_old, residual) / square) * old
        z = precondition(residual)
        size, before = dot(residual, z), size
        direction = z + (size / before) * direction
    return CGResult(step, image, max_iterations, False)

"""Preconditioned conjugate gradients on a batch of systems at once, on any device."""

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor


def solve_batch(
    times: Callable[[Tensor], Tensor],
    rhs: Float[Tensor, "cases nodes 3"],
    precondition: Callable[[Tensor], Tensor],
    accuracy: Float[Tensor, " cases"],
    limit: int,
) -> Float[Tensor, "cases nodes 3"]:
    """Solve K x = rhs in every case, each to its own relative accuracy.

    Where a direction of negative curvature shows, the case ends with what it has, or with the
    preconditioned right-hand side if it has nothing: either lowers the energy (Steihaug, 1983).

    Args:
        times: Product with K, symmetric.
        rhs: Right-hand sides.
        precondition: Product with a positive definite stand-in for the inverse of K.
        accuracy: Residual over right-hand side, in the preconditioner's norm, at which to stop.
        limit: Cap on iterations.
    """
    x = torch.zeros_like(rhs)
    r = rhs.clone()
    z = precondition(r)
    direction = z.clone()
    rz = _dot(r, z)
    goal = accuracy**2 * rz
    active = rz > 0
    for iteration in range(limit):
        if not bool(active.any()):
            break
        image = times(direction)
        curvature = _dot(direction, image)
        bent = active & (curvature <= 0)
        if iteration == 0:
            x = torch.where(bent[:, None, None], z, x)
        active = active & ~bent
        length = torch.where(active, rz / torch.where(active, curvature, 1.0), 0.0)[:, None, None]
        x = x + length * direction
        r = r - length * image
        z = precondition(r)
        after = _dot(r, z)
        active = active & (after > goal)
        ratio = torch.where(active, after / torch.where(rz > 0, rz, 1.0), 0.0)[:, None, None]
        direction = z + ratio * direction
        rz = after
    return x


def _dot(a: Float[Tensor, "cases nodes 3"], b: Float[Tensor, "cases nodes 3"]) -> Tensor:
    return (a * b).flatten(1).sum(1)

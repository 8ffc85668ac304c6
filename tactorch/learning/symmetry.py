"""Rotations and reflections of samples that keep the set of pressed sides."""

from collections.abc import Sequence
from itertools import permutations, product

import numpy as np
from jaxtyping import Float
from torch import Tensor

Symmetry = tuple[tuple[int, int, int], tuple[int, int, int]]
IDENTITY: Symmetry = ((0, 1, 2), (1, 1, 1))


def symmetries(directions: Float[np.ndarray, "k 3"]) -> list[Symmetry]:
    """Return the cube's symmetries that keep a set of push directions as it is.

    A symmetry is an order of the axes and a sign of each: axis i of the image is axis `order[i]`
    of the original, times `signs[i]`. An object seen through one is an object as likely, pressed
    from the same sides.

    Args:
        directions: Unit vectors along the axes, each once or more.
    """
    pushed = {tuple(np.round(d).astype(int).tolist()) for d in directions}
    allowed: list[Symmetry] = []
    for order, signs in product(permutations(range(3)), product((1, -1), repeat=3)):
        moved = {tuple(s * d[o] for o, s in zip(order, signs, strict=True)) for d in pushed}
        if moved == pushed:
            allowed.append((order, signs))  # type: ignore[arg-type]
    return allowed


def apply(symmetry: Symmetry, field: Tensor, vectors: Sequence[int] = ()) -> Tensor:
    """Return fields on a cubic grid as seen through a symmetry.

    Args:
        symmetry: See `symmetries`.
        field: (..., channels, v, v, v).
        vectors: First channels of the vector fields among them, whose components turn as well.
    """
    order, signs = symmetry
    lead = field.dim() - 3
    moved = field.permute(*range(lead), *(lead + axis for axis in order))
    flipped = [lead + axis for axis, sign in enumerate(signs) if sign < 0]
    moved = moved.flip(flipped) if flipped else moved
    if not vectors:
        return moved
    turned = moved.clone()
    for first in vectors:
        for axis, (source, sign) in enumerate(zip(order, signs, strict=True)):
            turned[..., first + axis, :, :, :] = sign * moved[..., first + source, :, :, :]
    return turned

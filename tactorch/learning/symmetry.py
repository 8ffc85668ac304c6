"""Rotations and reflections of samples that keep the set of pressed sides."""

from collections.abc import Sequence
from itertools import permutations, product

import numpy as np
from jaxtyping import Float
from torch import Tensor

Symmetry = tuple[tuple[int, int, int], tuple[int, int, int]]
IDENTITY: Symmetry = ((0, 1, 2), (1, 1, 1))


def symmetries(directions: Float[np.ndarray, "k 3"]) -> list[Symmetry]:
    """Return the symmetries of the cube under which a set of push directions is invariant.

    A symmetry is an order of the axes and a sign of each: axis i of the image is axis `order[i]`
    of the original, times `signs[i]`. The transformed object is equally likely and pressed from
    the same sides.

    Args:
        directions: Unit vectors along the axes, (k, 3); duplicates are allowed.
    """
    pushed = {tuple(np.round(d).astype(int).tolist()) for d in directions}
    allowed: list[Symmetry] = []
    for order, signs in product(permutations(range(3)), product((1, -1), repeat=3)):
        image = {tuple(s * d[o] for o, s in zip(order, signs, strict=True)) for d in pushed}
        if image == pushed:
            allowed.append((order, signs))  # type: ignore[arg-type]
    return allowed


def apply_symmetry(symmetry: Symmetry, field: Tensor, vectors: Sequence[int] = ()) -> Tensor:
    """Return fields on a cubic grid, transformed by a symmetry.

    Args:
        symmetry: Order and signs of the axes, see `symmetries`.
        field: Fields, (..., channels, v, v, v).
        vectors: First channels of the vector fields, whose components are transformed as well.
    """
    order, signs = symmetry
    lead = field.dim() - 3
    image = field.permute(*range(lead), *(lead + axis for axis in order))
    flipped = [lead + axis for axis, sign in enumerate(signs) if sign < 0]
    image = image.flip(flipped) if flipped else image
    if not vectors:
        return image
    rotated = image.clone()
    for first in vectors:
        for axis, (source, sign) in enumerate(zip(order, signs, strict=True)):
            rotated[..., first + axis, :, :, :] = sign * image[..., first + source, :, :, :]
    return rotated

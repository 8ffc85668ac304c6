"""Points far from one another."""

import numpy as np
from jaxtyping import Float


def farthest_order(points: Float[np.ndarray, "n d"], count: int, first: int) -> list[int]:
    """Return `count` indices (all, if there are fewer points), each farthest from those before.

    No index comes twice, not even where points coincide.

    Args:
        points: Their positions.
        count: How many.
        first: Index to begin with.
    """
    order = [first]
    nearest = np.linalg.norm(points - points[first], axis=1)
    nearest[first] = -1.0
    while len(order) < min(count, len(points)):
        order.append(int(nearest.argmax()))
        nearest = np.minimum(nearest, np.linalg.norm(points - points[order[-1]], axis=1))
        nearest[order[-1]] = -1.0
    return order

"""Is the object held? Six rigid motions, and the supports that must resist each of them."""

import numpy as np
from jaxtyping import Bool, Float

_MOTIONS = ("slide along x", "slide along y", "slide along z")
_TURNS = ("turn about x", "turn about y", "turn about z")
# Motions resisted by less than this part of the best-resisted one count as free.
_RELATIVE = 1e-9


def free_motion(points: Float[np.ndarray, "n 3"], held: Bool[np.ndarray, "n 3"]) -> str | None:
    """Name a rigid motion that the held degrees of freedom let through, or return None.

    The object's rigid motions, scaled to its size, are restricted to the held degrees of freedom;
    a combination that vanishes there is free. The name is that of the motion most present in it.

    Args:
        points: Rest positions, (n, 3), mm.
        held: Degrees of freedom held by springs or fixations, (n, 3).
    """
    if not held.any():
        return "move freely"
    # About the middle of the supports, a turn about an axis that they lie on is nothing but that.
    modes = _rigid_modes(points - points[held.any(axis=1)].mean(axis=0))[held]
    _, values, vectors = np.linalg.svd(modes, full_matrices=True)
    rank = int((values > _RELATIVE * values[0]).sum())
    if rank == 6:
        return None
    free = vectors[rank:]
    return (_MOTIONS + _TURNS)[int(np.argmax((free**2).sum(axis=0)))]


def _rigid_modes(offsets: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 6"]:
    scaled = offsets / np.abs(offsets).max()
    modes = np.zeros((len(offsets), 3, 6))
    modes[:, :, :3] = np.eye(3)
    for axis in range(3):
        modes[:, :, 3 + axis] = np.cross(np.eye(3)[axis], scaled)
    return modes

"""Prior of the parameters of inclusions and backgrounds."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tactorch.mesh import TetMesh

# Standard deviation of the length outside the bounding box, over the size of the body. A faint
# inclusion beyond it would act as a background that varies.
_OUTSIDE = 0.1


@dataclass(frozen=True, eq=False)
class ShapePrior:
    """Normal prior of the parameters of shapes, wide enough for any body.

    Centres are within the body's bounding box (one standard deviation is half its extent), radii
    around a seventh of its size, moduli of inclusions within a factor of four or so.

    Attributes:
        outside_mm: Standard deviation of the length by which an inclusion extends beyond the
            bounding box at each side, mm; None without such a penalty.
    """

    low_mm: Float[np.ndarray, "3"]
    high_mm: Float[np.ndarray, "3"]
    size_mm: float
    log_background: float

    background: float = 1.0
    mode: float = 0.4
    log_radius: float = 0.6
    distortion: float = 0.35
    log_contrast: float = 1.5
    outside_mm: float | None = None

    @staticmethod
    def of(mesh: TetMesh, background_mpa: float) -> "ShapePrior":
        """Return the prior for a body whose best uniform modulus is given."""
        low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
        size = float(np.cbrt(mesh.volumes.sum()))
        return ShapePrior(low, high, size, np.log(background_mpa), outside_mm=_OUTSIDE * size)

"""Sparsity: most of the object is background, and what departs from it may depart far."""

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.inverse.regularization.levels import log_level, relative_volumes, smoothed_median
from tactorch.mesh import TetMesh


class Sparsity:
    """Sum over elements of volume * sqrt((log e - background)^2 + edge^2), in mean volumes.

    Reweighted least squares, as in total variation.

    Args:
        mesh: The object.
        level_mpa: Background, MPa: one modulus, or one an element; None takes the volume-weighted
            median of the log-moduli, smoothed as the penalty is. That level minimises the sum, so
            the gradient is exact although the level follows the field.
        edge: Distance of log-modulus below which the penalty is quadratic.

    Raises:
        ConfigError: `edge` or a level is not positive, or the shape of the level is wrong.
    """

    name = "sparsity"

    def __init__(
        self,
        mesh: TetMesh,
        level_mpa: float | Float[np.ndarray, " m"] | None = None,
        edge: float = 0.03,
    ) -> None:
        """Take the volumes and the background."""
        if not edge > 0:
            raise ConfigError(f"regularization.edge={edge} must be above 0 (log-modulus).")
        self.edge = edge
        self._volumes = relative_volumes(mesh)
        self._level = log_level(level_mpa, mesh.n_tets)

    def _parts(self, field: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distances from the background, and their smoothed sizes."""
        level = self._level
        if level is None:
            level = smoothed_median(field, self._volumes, self.edge)
        distance = field - level
        return distance, np.sqrt(distance * distance + self.edge**2)

    def value(self, field: Float[np.ndarray, " m"]) -> float:
        """Return the penalty, zero at the background."""
        return float(self._volumes @ (self._parts(field)[1] - self.edge))

    def gradient(self, field: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Return the penalty's gradient."""
        distance, size = self._parts(field)
        return self._volumes * distance / size

    def curvature(self, field: Float[np.ndarray, " m"]) -> sp.csr_matrix:
        """Return the majorant at `field`."""
        return sp.diags(self._volumes / self._parts(field)[1]).tocsr()

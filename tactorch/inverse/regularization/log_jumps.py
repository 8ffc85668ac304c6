"""Logarithm of jumps: a large jump costs hardly more than a middling one, so contrast survives."""

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.inverse.regularization.base import jumps, relative_areas
from tactorch.mesh import TetMesh


class LogJumps:
    """Sum over interior faces of area * edge * log(1 + (jump / edge)^2), in mean areas.

    Not convex: total variation shrinks a jump by the same force whatever its size, this one by less
    the larger it is (Lorentzian of Black and Rangarajan, 1996). Concave in the squared jump, so
    reweighted least squares still lowers it: the curvature is a majorant's.

    Args:
        mesh: The object.
        edge: Jump of log-modulus at which the force is largest.

    Raises:
        ConfigError: `edge` is not positive.
    """

    name = "log_jumps"

    def __init__(self, mesh: TetMesh, edge: float = 0.1) -> None:
        """Assemble the jumps."""
        if not edge > 0:
            raise ConfigError(f"regularization.edge={edge} must be above 0 (log-modulus).")
        self.edge = edge
        self._jumps = jumps(mesh)
        self._areas = relative_areas(mesh)

    def _weights(self, difference: np.ndarray) -> np.ndarray:
        return 2.0 * self._areas * self.edge / (self.edge**2 + difference * difference)

    def value(self, field: Float[np.ndarray, " m"]) -> float:
        """Return the penalty, zero for a uniform field."""
        ratio = (self._jumps @ field) / self.edge
        return self.edge * float(self._areas @ np.log1p(ratio * ratio))

    def gradient(self, field: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Return the penalty's gradient."""
        difference = self._jumps @ field
        return self._jumps.T @ (self._weights(difference) * difference)

    def curvature(self, field: Float[np.ndarray, " m"]) -> sp.csr_matrix:
        """Return the majorant at `field`."""
        weights = sp.diags(self._weights(self._jumps @ field))
        return (self._jumps.T @ weights @ self._jumps).tocsr()

"""Total variation: jumps across faces count by their size, so that edges stay sharp."""

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.inverse.regularization.base import jumps, relative_areas
from tactorch.mesh import TetMesh


class TotalVariation:
    """Sum over interior faces of area * sqrt(jump^2 + edge^2), in units of the mean area.

    Reweighted least squares (lagged diffusivity, Vogel and Oman, 1996): the curvature at a field
    is the Hessian of the quadratic that touches the penalty there from above.

    Args:
        mesh: The object.
        edge: Jump of log-modulus below which the penalty is quadratic.

    Raises:
        ConfigError: `edge` is not positive.
    """

    name = "total_variation"

    def __init__(self, mesh: TetMesh, edge: float = 0.03) -> None:
        """Assemble the jumps."""
        if not edge > 0:
            raise ConfigError(f"regularization.edge={edge} must be above 0 (log-modulus).")
        self.edge = edge
        self._jumps = jumps(mesh)
        self._areas = relative_areas(mesh)

    def _size(self, field: np.ndarray) -> np.ndarray:
        difference = self._jumps @ field
        return np.sqrt(difference * difference + self.edge**2)

    def value(self, field: Float[np.ndarray, " m"]) -> float:
        """Return the penalty, zero for a uniform field."""
        return float(self._areas @ (self._size(field) - self.edge))

    def gradient(self, field: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Return the penalty's gradient."""
        return self._jumps.T @ (self._areas * (self._jumps @ field) / self._size(field))

    def curvature(self, field: Float[np.ndarray, " m"]) -> sp.csr_matrix:
        """Return the majorant at `field`."""
        weights = sp.diags(self._areas / self._size(field))
        return (self._jumps.T @ weights @ self._jumps).tocsr()

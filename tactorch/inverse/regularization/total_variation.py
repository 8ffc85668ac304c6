"""Total variation: jumps across faces count by their size, so that edges stay sharp."""

import numpy as np
from jaxtyping import Float

from tactorch.inverse.regularization.base import JumpPenalty
from tactorch.mesh import TetMesh


class TotalVariation(JumpPenalty):
    """Sum over interior faces of area * sqrt(jump^2 + edge^2), in units of the mean area.

    Reweighted least squares is lagged diffusivity here (Vogel and Oman, 1996).

    Args:
        mesh: The object.
        edge: Jump of log-modulus below which the penalty is quadratic.

    Raises:
        ConfigError: `edge` is not positive.
    """

    name = "total_variation"

    def __init__(self, mesh: TetMesh, edge: float = 0.03) -> None:
        """Assemble the jumps."""
        super().__init__(mesh, edge)

    def _size(self, jump: np.ndarray) -> np.ndarray:
        return np.sqrt(jump * jump + self.edge**2)

    def _weights(self, jump: Float[np.ndarray, " faces"]) -> Float[np.ndarray, " faces"]:
        return self._areas / self._size(jump)

    def value(self, field: Float[np.ndarray, " m"]) -> float:
        """Return the penalty, zero for a uniform field."""
        return float(self._areas @ (self._size(self._jumps @ field) - self.edge))

"""Logarithm of jumps: a large jump costs hardly more than a middling one, so contrast survives."""

import numpy as np
from jaxtyping import Float

from tactorch.inverse.regularization.base import JumpPenalty
from tactorch.mesh import TetMesh


class LogJumps(JumpPenalty):
    """Sum over interior faces of area * edge * log(1 + (jump / edge)^2), in mean areas.

    Not convex: total variation shrinks a jump by the same force whatever its size, this one by less
    the larger it is (Lorentzian of Black and Rangarajan, 1996).

    Args:
        mesh: The object.
        edge: Jump of log-modulus at which the force is largest.

    Raises:
        ConfigError: `edge` is not positive.
    """

    name = "log_jumps"

    def __init__(self, mesh: TetMesh, edge: float = 0.1) -> None:
        """Assemble the jumps."""
        super().__init__(mesh, edge)

    def _weights(self, jump: Float[np.ndarray, " faces"]) -> Float[np.ndarray, " faces"]:
        return 2.0 * self._areas * self.edge / (self.edge**2 + jump * jump)

    def value(self, field: Float[np.ndarray, " m"]) -> float:
        """Return the penalty, zero for a uniform field."""
        ratio = (self._jumps @ field) / self.edge
        return self.edge * float(self._areas @ np.log1p(ratio * ratio))

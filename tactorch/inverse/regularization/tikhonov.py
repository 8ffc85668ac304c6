"""Tikhonov: every element stays near a reference, by its volume."""

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float

from tactorch.inverse.regularization.levels import log_level, relative_volumes
from tactorch.mesh import TetMesh


class Tikhonov:
    """Half the sum over elements of volume * (log e - reference)^2, in mean-volume units.

    Args:
        mesh: The object.
        level_mpa: Reference, MPa: one modulus, or one an element; None takes the volume-weighted
            mean of the log-moduli. That mean minimises the sum, so the gradient is exact although
            the reference follows the field.

    Raises:
        ConfigError: a reference is not positive, or its shape is wrong.
    """

    name = "tikhonov"

    def __init__(
        self, mesh: TetMesh, level_mpa: float | Float[np.ndarray, " m"] | None = None
    ) -> None:
        """Take the volumes and the reference."""
        self._volumes = relative_volumes(mesh)
        self._level = log_level(level_mpa, mesh.n_tets)

    def _distance(self, field: np.ndarray) -> np.ndarray:
        level = np.average(field, weights=self._volumes) if self._level is None else self._level
        return field - level

    def value(self, field: Float[np.ndarray, " m"]) -> float:
        """Return the penalty, zero at the reference."""
        distance = self._distance(field)
        return 0.5 * float(self._volumes @ (distance * distance))

    def gradient(self, field: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Return the penalty's gradient."""
        return self._volumes * self._distance(field)

    def curvature(self, field: Float[np.ndarray, " m"]) -> sp.csr_matrix:
        """Return the Hessian at a reference that stays; a majorant where it follows the field."""
        return sp.diags(self._volumes).tocsr()

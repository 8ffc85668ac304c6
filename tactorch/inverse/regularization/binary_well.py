"""The paper's binary well: tissue or inclusion, nothing between."""

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.inverse.regularization.levels import relative_volumes, two_levels
from tactorch.mesh import TetMesh


class BinaryWell:
    """Sum over elements of volume * (f - f_c)^2 (f - f_t)^2, in mean volumes; f = log e.

    The paper (Section VII) writes (e - e_c)^2 (e - e_t)^2 on moduli. Here it acts on log-moduli as
    every prior does: both wells are then as wide whatever the contrast. It is not convex.

    Args:
        mesh: The object.
        levels_mpa: The two moduli e_t and e_c, MPa; None takes those that make the sum smallest
            for the present field, so the gradient is exact although they follow the field.

    Raises:
        ConfigError: the levels are not two different positive numbers.
    """

    name = "binary_well"

    def __init__(self, mesh: TetMesh, levels_mpa: Sequence[float] | None = None) -> None:
        """Take the volumes and the levels."""
        self._volumes = relative_volumes(mesh)
        self._levels: tuple[float, float] | None = None
        if levels_mpa is not None:
            levels = np.asarray(levels_mpa, dtype=np.float64)
            if levels.shape != (2,) or not np.all(levels > 0) or levels[0] == levels[1]:
                raise ConfigError(
                    f"regularization.levels_mpa={levels_mpa}: give two different moduli above 0 "
                    "MPa, or null."
                )
            self._levels = (float(np.log(levels[0])), float(np.log(levels[1])))

    def levels(self, field: Float[np.ndarray, " m"]) -> tuple[float, float]:
        """Return the log-moduli at the bottom of the wells: given, or of this field."""
        return two_levels(field, self._volumes) if self._levels is None else self._levels

    def _parts(self, field: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The product (f - f_c)(f - f_t), and its derivative."""
        one, other = self.levels(field)
        return (field - one) * (field - other), 2.0 * field - one - other

    def value(self, field: Float[np.ndarray, " m"]) -> float:
        """Return the penalty, zero for a map of the two levels."""
        product, _ = self._parts(field)
        return float(self._volumes @ (product * product))

    def gradient(self, field: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Return the penalty's gradient."""
        product, slope = self._parts(field)
        return self._volumes * 2.0 * product * slope

    def curvature(self, field: Float[np.ndarray, " m"]) -> sp.csr_matrix:
        """Return the Hessian without what is negative between the wells; no majorant."""
        product, slope = self._parts(field)
        convex = 2.0 * slope * slope + 4.0 * np.maximum(product, 0.0)
        return sp.diags(self._volumes * convex).tocsr()

"""A prior about a map: what any prior says of the distance from a map that is likely beforehand."""

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.inverse.regularization.base import Regularizer


class ShiftedPrior:
    """The penalty of (f - log mean) / deviation, f the field of log-moduli.

    Args:
        inner: The prior of that.
        mean_mpa: The likely map, MPa, one modulus an element: what a surrogate foretells, say.
        deviation: Standard deviation of each element's log-modulus about it, or None for 1.

    Raises:
        ConfigError: A mean or a deviation is not positive, or not one an element.
    """

    def __init__(
        self,
        inner: Regularizer,
        mean_mpa: Float[np.ndarray, " _"],
        deviation: Float[np.ndarray, " _"] | None,
        size: int,
    ) -> None:
        """Take the mean's logarithm."""
        for name, values in (("mean_mpa", mean_mpa), ("deviation", deviation)):
            if values is None:
                continue
            if values.shape != (size,):
                raise ConfigError(f"prior {name} has shape {values.shape}; give ({size},).")
            if not (np.isfinite(values).all() and (values > 0).all()):
                raise ConfigError(f"prior {name} must be above 0 everywhere.")
        self.name = inner.name
        self._inner, self._mean = inner, np.log(mean_mpa)
        self._scale = np.ones(size) if deviation is None else 1.0 / deviation

    def _distance(self, field: np.ndarray) -> np.ndarray:
        return self._scale * (field - self._mean)

    def value(self, field: Float[np.ndarray, " m"]) -> float:
        """Return the penalty."""
        return self._inner.value(self._distance(field))

    def gradient(self, field: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Return the penalty's gradient."""
        return self._scale * self._inner.gradient(self._distance(field))

    def curvature(self, field: Float[np.ndarray, " m"]) -> sp.csr_matrix:
        """Return the inner prior's, in the field's units."""
        scale = sp.diags(self._scale)
        return (scale @ self._inner.curvature(self._distance(field)) @ scale).tocsr()

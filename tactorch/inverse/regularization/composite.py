"""A weighted sum of priors."""

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.inverse.regularization.base import Regularizer


class Composite:
    """Sum of share * prior; the weight that is chosen with the data multiplies the whole.

    Args:
        parts: Pairs of a share and a prior.

    Raises:
        ConfigError: there is no part, or a share is not positive.
    """

    name = "composite"

    def __init__(self, parts: Sequence[tuple[float, Regularizer]]) -> None:
        """Take the parts."""
        if not parts:
            raise ConfigError("regularization.parts is empty; give {NAME: SHARE, ...}.")
        for share, prior in parts:
            if not 0 < share < np.inf:
                raise ConfigError(
                    f"regularization.parts: {prior.name} has share {share}; it must be above 0."
                )
        self.parts = tuple(parts)

    def value(self, field: Float[np.ndarray, " m"]) -> float:
        """Return the penalty."""
        return sum(share * prior.value(field) for share, prior in self.parts)

    def gradient(self, field: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Return the penalty's gradient."""
        gradient = np.zeros_like(field)
        for share, prior in self.parts:
            gradient += share * prior.gradient(field)
        return gradient

    def curvature(self, field: Float[np.ndarray, " m"]) -> sp.csr_matrix:
        """Return the sum of the parts' curvatures, a majorant's if each of them is."""
        total = sp.csr_matrix((len(field), len(field)))
        for share, prior in self.parts:
            total = total + share * prior.curvature(field)
        return total.tocsr()

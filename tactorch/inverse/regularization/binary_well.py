"""The paper's binary well: a penalty with two levels of log-modulus, given or estimated."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float

from tactorch.config import option
from tactorch.errors import ConfigError
from tactorch.inverse.regularization.base import Prior, Regularizer, relative
from tactorch.mesh import TetMesh


@dataclass(frozen=True, kw_only=True)
class BinaryWell(Prior):
    """The paper's binary well: two levels, tissue and inclusion.

    Sum over elements of volume * (f - f_c)^2 (f - f_t)^2, in mean volumes, with f = log E. The
    paper (Section VII) states it for moduli; for log-moduli both wells are equally wide at any
    contrast. It is not convex. Levels that are estimated minimise the sum for the present field.
    """

    levels_mpa: tuple[float, float] | None = option(
        None, "Moduli of tissue and inclusion; null: estimated from the present map", unit="MPa",
        gt=0,
    )  # fmt: skip

    def __post_init__(self) -> None:
        """Check the levels."""
        super().__post_init__()
        if self.levels_mpa is not None and self.levels_mpa[0] == self.levels_mpa[1]:
            raise ConfigError(
                f"regularization.levels_mpa={list(self.levels_mpa)}: give two different moduli "
                "above 0 MPa, or null."
            )

    def on(self, mesh: TetMesh) -> Regularizer:
        """Return the penalty on a mesh."""
        return _BinaryWellPenalty(relative(mesh.volumes), self.levels_mpa)


class _BinaryWellPenalty(Regularizer):
    """The penalty of `BinaryWell` on a mesh: (f - f_c)^2 (f - f_t)^2 by relative volumes."""

    def __init__(
        self, volumes: Float[np.ndarray, " m"], levels_mpa: tuple[float, float] | None
    ) -> None:
        self._volumes = volumes
        self._levels = levels_mpa and (float(np.log(levels_mpa[0])), float(np.log(levels_mpa[1])))

    def _product(self, field: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the product (f - f_c)(f - f_t), and its derivative."""
        low, high = self._levels or two_levels(field, self._volumes)
        return (field - low) * (field - high), 2.0 * field - low - high

    def value(self, field: Float[np.ndarray, " m"]) -> float:
        product, _ = self._product(field)
        return float(self._volumes @ (product * product))

    def gradient(self, field: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        product, slope = self._product(field)
        return self._volumes * 2.0 * product * slope

    def curvature(self, field: Float[np.ndarray, " m"]) -> sp.csr_matrix:
        # The Hessian without its negative part between the wells; no majorant.
        product, slope = self._product(field)
        convex = 2.0 * slope * slope + 4.0 * np.maximum(product, 0.0)
        return sp.diags(self._volumes * convex).tocsr()


def two_levels(
    field: Float[np.ndarray, " m"], weights: Float[np.ndarray, " m"]
) -> tuple[float, float]:
    """Return the levels (low, high) that minimise the sum of weights * (f - low)^2 (f - high)^2.

    With p(f) = f^2 - s f + q = (f - low)(f - high) this is linear least squares in s and q, and p
    is the second orthogonal polynomial of the field's distribution: its roots are real and within
    the field's range. They are the nodes of the two-point Gauss rule: exact for a binary map.
    """
    mean = float(np.average(field, weights=weights))
    centred = field - mean
    variance = float(np.average(centred**2, weights=weights))
    if variance <= 1e-24 * max(1.0, mean * mean):
        return mean, mean
    skew = float(np.average(centred**3, weights=weights)) / variance
    half = float(np.sqrt(0.25 * skew * skew + variance))
    return mean + 0.5 * skew - half, mean + 0.5 * skew + half

"""Two-parameter Mooney-Rivlin material."""

from dataclasses import dataclass

from tactorch.errors import ConfigError
from tactorch.fem.materials.base import (
    Dilatation,
    InvariantDerivatives,
    IsotropicMaterial,
    Scalars,
    bulk,
    lame,
)
from tactorch.fem.materials.isochoric import quadratic_dilatation


@dataclass(frozen=True)
class MooneyRivlin(IsotropicMaterial):
    """psi = c1 (J^(-2/3) I1 - 3) + c2 (J^(-4/3) I2 - 3) + kappa/4 (J^2 - 1 - 2 ln J).

    c1 + c2 = mu/2, so that the small-strain moduli are `youngs` and `poisson`.

    Attributes:
        second_fraction: c2 / (c1 + c2), from 0 (Neo-Hookean) to 1.

    Raises:
        ConfigError: `second_fraction` is outside [0, 1].
    """

    second_fraction: float = 0.2

    def __post_init__(self) -> None:
        """Check both parameters."""
        super().__post_init__()
        if not 0.0 <= self.second_fraction <= 1.0:
            raise ConfigError(f"second_fraction={self.second_fraction} is outside [0, 1].")

    def distortion(
        self, i1: Scalars, i2: Scalars, j: Scalars, log_j: Scalars, poisson: Scalars
    ) -> InvariantDerivatives:
        """c1 (J^(-2/3) I1 - 3) + c2 (J^(-4/3) I2 - 3)."""
        half_mu = 0.5 * lame(poisson)[1]
        a = (1.0 - self.second_fraction) * half_mu * j ** (-2.0 / 3.0)
        b = self.second_fraction * half_mu * j ** (-4.0 / 3.0)
        return InvariantDerivatives(
            psi=a * i1 + b * i2 - 3.0 * half_mu,
            d1=a,
            d2=b,
            dj=-(2.0 * a * i1 + 4.0 * b * i2) / (3.0 * j),
            d1j=-2.0 / 3.0 * a / j,
            d2j=-4.0 / 3.0 * b / j,
            djj=(10.0 * a * i1 + 28.0 * b * i2) / (9.0 * j * j),
        )

    def dilatation(self, j: Scalars, log_j: Scalars, poisson: Scalars) -> Dilatation:
        """kappa/4 (J^2 - 1 - 2 ln J)."""
        return quadratic_dilatation(j, log_j, bulk(poisson))

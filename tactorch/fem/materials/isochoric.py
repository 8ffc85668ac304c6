"""Materials split into isochoric and volumetric parts, for Poisson's ratios near 0.5."""

from dataclasses import dataclass

from tactorch.config import option
from tactorch.fem.materials.base import (
    InvariantDerivatives,
    IsotropicMaterial,
    Scalars,
    VolumetricDerivatives,
    bulk,
    lame,
)


class _IsochoricMaterial(IsotropicMaterial):
    """c1 (J^(-2/3) I1 - 3) + c2 (J^(-4/3) I2 - 3) + kappa/4 (J^2 - 1 - 2 ln J).

    c1 + c2 = mu/2, so that the moduli at small strain are `youngs` and `poisson`. The volumetric
    part is that of Simo and Taylor (1991).
    """

    _c2_fraction = 0.0

    def _coefficients(self, j: Scalars, poisson: Scalars) -> tuple[Scalars, Scalars]:
        """Factors of I1 and I2 in the energy."""
        half_mu = 0.5 * lame(poisson)[1]
        c1 = (1.0 - self._c2_fraction) * half_mu * j ** (-2.0 / 3.0)
        if self._c2_fraction == 0.0:
            return c1, 0.0
        return c1, self._c2_fraction * half_mu * j ** (-4.0 / 3.0)

    def strain_energy(
        self, i1: Scalars, i2: Scalars, j: Scalars, log_j: Scalars, poisson: Scalars
    ) -> Scalars:
        """Return c1 (J^(-2/3) I1 - 3) + c2 (J^(-4/3) I2 - 3)."""
        a, b = self._coefficients(j, poisson)
        return a * i1 + b * i2 - 1.5 * lame(poisson)[1]

    def volumetric_energy(self, j: Scalars, log_j: Scalars, poisson: Scalars) -> Scalars:
        """Return kappa/4 (J^2 - 1 - 2 ln J)."""
        return 0.25 * bulk(poisson) * (j * j - 1.0 - 2.0 * log_j)

    def strain_derivatives(
        self, i1: Scalars, i2: Scalars, j: Scalars, log_j: Scalars, poisson: Scalars
    ) -> InvariantDerivatives:
        """Closed form."""
        a, b = self._coefficients(j, poisson)
        return InvariantDerivatives(
            a * i1 + b * i2 - 1.5 * lame(poisson)[1],
            d1=a,
            d2=b,
            dj=-(2.0 * a * i1 + 4.0 * b * i2) / (3.0 * j),
            d1j=-2.0 / 3.0 * a / j,
            d2j=-4.0 / 3.0 * b / j,
            djj=(10.0 * a * i1 + 28.0 * b * i2) / (9.0 * j * j),
        )

    def volumetric_derivatives(
        self, j: Scalars, log_j: Scalars, poisson: Scalars
    ) -> VolumetricDerivatives:
        """Closed form."""
        kappa, psi = bulk(poisson), self.volumetric_energy(j, log_j, poisson)
        return VolumetricDerivatives(
            psi, 0.5 * kappa * (j - 1.0 / j), 0.5 * kappa * (1.0 + 1.0 / (j * j))
        )


@dataclass(frozen=True)
class IsochoricNeoHookean(_IsochoricMaterial):
    """Neo-Hookean solid with separate volumetric part, for Poisson's ratios near 0.5.

    psi = mu/2 (J^(-2/3) I1 - 3) + kappa/4 (J^2 - 1 - 2 ln J).
    """


@dataclass(frozen=True)
class MooneyRivlin(_IsochoricMaterial):
    """Mooney-Rivlin solid with separate volumetric part.

    psi = c1 (J^(-2/3) I1 - 3) + c2 (J^(-4/3) I2 - 3) + kappa/4 (J^2 - 1 - 2 ln J), c1 + c2 = mu/2.
    """

    second_fraction: float = option(
        0.2, "c2 / (c1 + c2), from 0 (Neo-Hookean) to 1", ge=0.0, le=1.0
    )

    @property
    def _c2_fraction(self) -> float:  # type: ignore[override]
        return self.second_fraction

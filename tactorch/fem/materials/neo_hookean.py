"""The paper's Neo-Hookean material, eq. (2)."""

from dataclasses import dataclass

from tactorch.config import option
from tactorch.fem.materials.base import (
    InvariantDerivatives,
    IsotropicMaterial,
    Scalars,
    VolumetricDerivatives,
    lame,
)


@dataclass(frozen=True)
class NeoHookean(IsotropicMaterial):
    """Compressible Neo-Hookean solid, eq. (2) of the paper.

    psi = mu/2 (I1 - 3) - mu ln J + lame_factor lambda/2 (ln J)^2.
    """

    lame_factor: float = option(1.0, "Factor of lambda; 0.5 in the paper's published data")

    def strain_energy(
        self, i1: Scalars, i2: Scalars, j: Scalars, log_j: Scalars, poisson: Scalars
    ) -> Scalars:
        """Return mu/2 (I1 - 3) - mu ln J."""
        _, mu = lame(poisson)
        return 0.5 * mu * (i1 - 3.0) - mu * log_j

    def volumetric_energy(self, j: Scalars, log_j: Scalars, poisson: Scalars) -> Scalars:
        """Return lame_factor lambda/2 (ln J)^2."""
        return 0.5 * self.lame_factor * lame(poisson)[0] * log_j * log_j

    def strain_derivatives(
        self, i1: Scalars, i2: Scalars, j: Scalars, log_j: Scalars, poisson: Scalars
    ) -> InvariantDerivatives:
        """Closed form."""
        psi, mu = self.strain_energy(i1, i2, j, log_j, poisson), lame(poisson)[1]
        return InvariantDerivatives(psi, d1=0.5 * mu, dj=-mu / j, djj=mu / (j * j))

    def volumetric_derivatives(
        self, j: Scalars, log_j: Scalars, poisson: Scalars
    ) -> VolumetricDerivatives:
        """Closed form."""
        lam = self.lame_factor * lame(poisson)[0]
        psi = self.volumetric_energy(j, log_j, poisson)
        return VolumetricDerivatives(psi, lam * log_j / j, lam * (1.0 - log_j) / (j * j))

"""The paper's Neo-Hookean material, eq. (2)."""

from dataclasses import dataclass

from tactorch.fem.materials.base import (
    Dilatation,
    InvariantDerivatives,
    IsotropicMaterial,
    Scalars,
    lame,
)


@dataclass(frozen=True)
class NeoHookean(IsotropicMaterial):
    """psi = mu/2 (I1 - 3) - mu ln J + factor * lambda/2 (ln J)^2.

    Attributes:
        lame_factor: Multiplies lambda; one in the paper, 0.5 in its published data.
    """

    lame_factor: float = 1.0

    def distortion(
        self, i1: Scalars, i2: Scalars, j: Scalars, log_j: Scalars, poisson: Scalars
    ) -> InvariantDerivatives:
        """mu/2 (I1 - 3) - mu ln J."""
        _, mu = lame(poisson)
        return InvariantDerivatives(
            psi=0.5 * mu * (i1 - 3.0) - mu * log_j, d1=0.5 * mu, dj=-mu / j, djj=mu / (j * j)
        )

    def dilatation(self, j: Scalars, log_j: Scalars, poisson: Scalars) -> Dilatation:
        """lambda/2 (ln J)^2."""
        lam = self.lame_factor * lame(poisson)[0]
        return Dilatation(
            psi=0.5 * lam * log_j * log_j, dj=lam * log_j / j, djj=lam * (1.0 - log_j) / (j * j)
        )

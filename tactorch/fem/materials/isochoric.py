"""Neo-Hookean material split into isochoric and volumetric parts."""

from dataclasses import dataclass

from tactorch.fem.materials.base import (
    Dilatation,
    InvariantDerivatives,
    IsotropicMaterial,
    Scalars,
    bulk,
    lame,
)


def quadratic_dilatation(j: Scalars, log_j: Scalars, kappa: Scalars) -> Dilatation:
    """U = kappa/4 (J^2 - 1 - 2 ln J), Simo and Taylor (1991)."""
    return Dilatation(
        psi=0.25 * kappa * (j * j - 1.0 - 2.0 * log_j),
        dj=0.5 * kappa * (j - 1.0 / j),
        djj=0.5 * kappa * (1.0 + 1.0 / (j * j)),
    )


@dataclass(frozen=True)
class IsochoricNeoHookean(IsotropicMaterial):
    """psi = mu/2 (J^(-2/3) I1 - 3) + kappa/4 (J^2 - 1 - 2 ln J)."""

    def distortion(
        self, i1: Scalars, i2: Scalars, j: Scalars, log_j: Scalars, poisson: Scalars
    ) -> InvariantDerivatives:
        """mu/2 (J^(-2/3) I1 - 3)."""
        _, mu = lame(poisson)
        scale = 0.5 * mu * j ** (-2.0 / 3.0)
        return InvariantDerivatives(
            psi=scale * i1 - 1.5 * mu,
            d1=scale,
            dj=-2.0 / 3.0 * scale * i1 / j,
            d1j=-2.0 / 3.0 * scale / j,
            djj=10.0 / 9.0 * scale * i1 / (j * j),
        )

    def dilatation(self, j: Scalars, log_j: Scalars, poisson: Scalars) -> Dilatation:
        """kappa/4 (J^2 - 1 - 2 ln J)."""
        return quadratic_dilatation(j, log_j, bulk(poisson))

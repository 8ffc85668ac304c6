"""Saint Venant-Kirchhoff material."""

from dataclasses import dataclass

from tactorch.fem.materials.base import InvariantDerivatives, IsotropicMaterial, Scalars, lame


@dataclass(frozen=True)
class StVenantKirchhoff(IsotropicMaterial):
    """Saint Venant-Kirchhoff solid, for small strains and large rotations.

    psi = lambda/2 (tr E)^2 + mu E:E with the Green strain E = (C - I) / 2. In invariants,
    tr E = (I1 - 3)/2 and E:E = (I1^2 - 2 I2 - 2 I1 + 3)/4. It softens in compression and has no
    energy barrier against inversion.
    """

    def strain_energy(
        self, i1: Scalars, i2: Scalars, j: Scalars, log_j: Scalars, poisson: Scalars
    ) -> Scalars:
        """Return lambda/8 (I1 - 3)^2 + mu/4 (I1^2 - 2 I2 - 2 I1 + 3)."""
        lam, mu = lame(poisson)
        trace = i1 - 3.0
        return 0.125 * lam * trace * trace + 0.25 * mu * (i1 * i1 - 2.0 * (i1 + i2) + 3.0)

    def strain_derivatives(
        self, i1: Scalars, i2: Scalars, j: Scalars, log_j: Scalars, poisson: Scalars
    ) -> InvariantDerivatives:
        """Closed form."""
        lam, mu = lame(poisson)
        return InvariantDerivatives(
            self.strain_energy(i1, i2, j, log_j, poisson),
            d1=0.25 * lam * (i1 - 3.0) + 0.5 * mu * (i1 - 1.0),
            d2=-0.5 * mu,
            d11=0.25 * lam + 0.5 * mu,
        )

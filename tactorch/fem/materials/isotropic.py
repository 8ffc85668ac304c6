"""Isotropic materials; their derivatives are in closed form."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from tactorch.config import option
from tactorch.fem.materials.base import (
    Array,
    EnergyDerivatives,
    Gradient,
    IsotropicMaterial,
    Material,
    bulk,
    lame,
)


@dataclass(frozen=True)
class NeoHookean(IsotropicMaterial):
    """Compressible Neo-Hookean solid, eq. (2) of the paper.

    psi = mu/2 (I1 - 3) - mu ln J + lame_factor lambda/2 (ln J)^2.
    """

    lame_factor: float = option(1.0, "Factor of lambda; 0.5 in the paper's published data")

    def strain_energy(self, i1: Array, i2: Array, j: Array, log_j: Array, poisson: Array) -> Array:
        _, mu = lame(poisson)
        return 0.5 * mu * (i1 - 3.0) - mu * log_j

    def volumetric_energy(self, j: Array, log_j: Array, poisson: Array) -> Array:
        return 0.5 * self.lame_factor * lame(poisson)[0] * log_j * log_j

    def strain_derivatives(
        self, i1: Array, i2: Array, j: Array, log_j: Array, poisson: Array
    ) -> EnergyDerivatives:
        psi, mu = self.strain_energy(i1, i2, j, log_j, poisson), lame(poisson)[1]
        return EnergyDerivatives(psi, d1=0.5 * mu, dj=-mu / j, djj=mu / (j * j))

    def volumetric_derivatives(self, j: Array, log_j: Array, poisson: Array) -> EnergyDerivatives:
        lam, psi = self.lame_factor * lame(poisson)[0], self.volumetric_energy(j, log_j, poisson)
        return EnergyDerivatives(psi, dj=lam * log_j / j, djj=lam * (1.0 - log_j) / (j * j))


@dataclass(frozen=True)
class StVenantKirchhoff(IsotropicMaterial):
    """Saint Venant-Kirchhoff solid, for small strains and large rotations.

    psi = lambda/2 (tr E)^2 + mu E:E with the Green strain E = (C - I) / 2. In invariants,
    tr E = (I1 - 3)/2 and E:E = (I1^2 - 2 I2 - 2 I1 + 3)/4. It softens in compression and has no
    energy barrier against inversion.
    """

    def strain_energy(self, i1: Array, i2: Array, j: Array, log_j: Array, poisson: Array) -> Array:
        lam, mu = lame(poisson)
        trace = i1 - 3.0
        return 0.125 * lam * trace * trace + 0.25 * mu * (i1 * i1 - 2.0 * (i1 + i2) + 3.0)

    def strain_derivatives(
        self, i1: Array, i2: Array, j: Array, log_j: Array, poisson: Array
    ) -> EnergyDerivatives:
        lam, mu = lame(poisson)
        psi = self.strain_energy(i1, i2, j, log_j, poisson)
        d1 = 0.25 * lam * (i1 - 3.0) + 0.5 * mu * (i1 - 1.0)
        return EnergyDerivatives(psi, d1=d1, d2=-0.5 * mu, d11=0.25 * lam + 0.5 * mu)


class _IsochoricMaterial(IsotropicMaterial):
    """c1 (J^(-2/3) I1 - 3) + c2 (J^(-4/3) I2 - 3) + kappa/4 (J^2 - 1 - 2 ln J).

    c1 + c2 = mu/2, so that the moduli at small strain are `youngs` and `poisson`. The volumetric
    part is that of Simo and Taylor (1991).
    """

    second_fraction = 0.0  # c2 / (c1 + c2)

    def _coefficients(self, j: Array, poisson: Array) -> tuple[Array, Array]:
        """Factors of I1 and I2 in the energy."""
        half_mu = 0.5 * lame(poisson)[1]
        c1 = (1.0 - self.second_fraction) * half_mu * j ** (-2.0 / 3.0)
        if self.second_fraction == 0.0:
            return c1, 0.0
        return c1, self.second_fraction * half_mu * j ** (-4.0 / 3.0)

    def strain_energy(self, i1: Array, i2: Array, j: Array, log_j: Array, poisson: Array) -> Array:
        a, b = self._coefficients(j, poisson)
        return a * i1 + b * i2 - 1.5 * lame(poisson)[1]

    def volumetric_energy(self, j: Array, log_j: Array, poisson: Array) -> Array:
        return 0.25 * bulk(poisson) * (j * j - 1.0 - 2.0 * log_j)

    def strain_derivatives(
        self, i1: Array, i2: Array, j: Array, log_j: Array, poisson: Array
    ) -> EnergyDerivatives:
        a, b = self._coefficients(j, poisson)
        return EnergyDerivatives(
            a * i1 + b * i2 - 1.5 * lame(poisson)[1],
            d1=a,
            d2=b,
            dj=-(2.0 * a * i1 + 4.0 * b * i2) / (3.0 * j),
            d1j=-2.0 / 3.0 * a / j,
            d2j=-4.0 / 3.0 * b / j,
            djj=(10.0 * a * i1 + 28.0 * b * i2) / (9.0 * j * j),
        )

    def volumetric_derivatives(self, j: Array, log_j: Array, poisson: Array) -> EnergyDerivatives:
        half_kappa, psi = 0.5 * bulk(poisson), self.volumetric_energy(j, log_j, poisson)
        return EnergyDerivatives(
            psi, dj=half_kappa * (j - 1.0 / j), djj=half_kappa * (1.0 + 1.0 / (j * j))
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


@dataclass(frozen=True)
class LinearElastic(Material):
    """Linear elasticity, for small strains and rotations.

    psi = lambda/2 (tr eps)^2 + mu eps:eps with eps = sym(F - I).
    """

    allows_inversion: ClassVar[bool] = True

    def energy(self, F: Gradient, poisson: Array) -> Float[Tensor, "*batch"]:
        return 0.5 * (self.stress(F, poisson) * _strain(F)).sum((-2, -1))

    def stress(self, F: Gradient, poisson: Array) -> Gradient:
        lam, mu = (_as_matrix(x, F) for x in lame(poisson))
        strain = _strain(F)
        trace = strain.diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None]
        return lam * trace * torch.eye(3).to(F) + 2.0 * mu * strain

    def tangent(self, F: Gradient, poisson: Array) -> Float[Tensor, "*batch 3 3 3 3"]:
        """Return lambda d_iI d_jJ + mu (d_ij d_IJ + d_iJ d_jI)."""
        lam, mu = (_as_matrix(x, F)[..., None, None] for x in lame(poisson))
        one = torch.eye(3).to(F)
        trace = torch.einsum("iI,jJ->iIjJ", one, one)
        shear = torch.einsum("ij,IJ->iIjJ", one, one) + torch.einsum("iJ,jI->iIjJ", one, one)
        return (lam * trace + mu * shear).expand(*F.shape[:-2], 3, 3, 3, 3)


def _strain(F: Tensor) -> Tensor:
    return 0.5 * (F + F.mT) - torch.eye(3).to(F)


def _as_matrix(value: Array, F: Tensor) -> Tensor:
    return torch.as_tensor(value, dtype=F.dtype, device=F.device)[..., None, None]

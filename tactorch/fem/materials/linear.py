"""Linear elasticity."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from tactorch.fem.materials.base import Array, Gradient, Material, lame


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

"""What a hyperelastic material is here: an energy per unit of Young's modulus.

The energy density of every material is `youngs * psi1(F)` at fixed Poisson's ratio, so stress
and tangent are given per unit modulus too, and the derivative of the internal force with
respect to an element's modulus is its unit force (eq. 11 of the paper).

Isotropic materials need only one small function of the invariants and its derivatives, written
in plain arithmetic: the same lines then run on NumPy arrays (inside the compiled kernels), on
torch tensors (the reference, CUDA, autograd), and on floats.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from tactorch.errors import ConfigError

# A float, a NumPy array or a torch tensor; elements broadcast.
Scalars = Any


def lame(poisson: Scalars) -> tuple[Scalars, Scalars]:
    """Return Lame's (lambda, mu) for a Young's modulus of one."""
    mu = 0.5 / (1.0 + poisson)
    return 2.0 * mu * poisson / (1.0 - 2.0 * poisson), mu


def bulk(poisson: Scalars) -> Scalars:
    """Return the bulk modulus for a Young's modulus of one."""
    return 1.0 / (3.0 * (1.0 - 2.0 * poisson))


class InvariantDerivatives(NamedTuple):
    """psi(I1, I2, J) per unit modulus, with its first and second derivatives."""

    psi: Scalars
    d1: Scalars = 0.0
    d2: Scalars = 0.0
    dj: Scalars = 0.0
    d11: Scalars = 0.0
    d12: Scalars = 0.0
    d1j: Scalars = 0.0
    d22: Scalars = 0.0
    d2j: Scalars = 0.0
    djj: Scalars = 0.0


class Dilatation(NamedTuple):
    """U(J) per unit modulus, with its first and second derivatives."""

    psi: Scalars
    dj: Scalars = 0.0
    djj: Scalars = 0.0


@dataclass(frozen=True)
class Material(ABC):
    """Energy density per unit Young's modulus, with closed-form stress and tangent.

    Attributes:
        poisson: Poisson's ratio, -1 < poisson < 0.5.

    Raises:
        ConfigError: `poisson` is outside its range.
    """

    poisson: float = 0.45

    def __post_init__(self) -> None:
        """Check the range of Poisson's ratio."""
        if not -1.0 < self.poisson < 0.5:
            raise ConfigError(
                f"poisson={self.poisson} is outside (-1, 0.5); soft tissue and silicone have 0.45 "
                "to 0.499 (exact incompressibility, 0.5, is not representable)."
            )

    @abstractmethod
    def energy(self, F: Float[Tensor, "*batch 3 3"], poisson: Scalars) -> Float[Tensor, "*batch"]:
        """Energy density per unit modulus (dimensionless)."""

    @abstractmethod
    def stress(
        self, F: Float[Tensor, "*batch 3 3"], poisson: Scalars
    ) -> Float[Tensor, "*batch 3 3"]:
        """First Piola-Kirchhoff stress per unit modulus, d psi1 / dF."""

    @abstractmethod
    def tangent(
        self, F: Float[Tensor, "*batch 3 3"], poisson: Scalars
    ) -> Float[Tensor, "*batch 3 3 3 3"]:
        """Tangent per unit modulus, d P_iI / d F_jJ at [i, I, j, J]."""


class IsotropicMaterial(Material):
    """A material given by its energy in the invariants of C = F^T F.

    I1 = tr C, I2 = (I1^2 - tr C^2) / 2, J = det F. The part that depends on J alone may be given
    apart as `dilatation`: elements that average the volume change use it so.
    """

    @abstractmethod
    def distortion(
        self, i1: Scalars, i2: Scalars, j: Scalars, log_j: Scalars, poisson: Scalars
    ) -> InvariantDerivatives:
        """Energy and derivatives of the part that is not `dilatation`."""

    def dilatation(self, j: Scalars, log_j: Scalars, poisson: Scalars) -> Dilatation:
        """Energy and derivatives of the part in J alone; none by default."""
        return Dilatation(0.0 * j)

    def energy(self, F: Float[Tensor, "*batch 3 3"], poisson: Scalars) -> Float[Tensor, "*batch"]:
        """Energy density per unit modulus (dimensionless)."""
        i1, i2, j = _invariants(F)
        log_j = torch.log(j)
        shape = self.distortion(i1, i2, j, log_j, poisson)
        return shape.psi + self.dilatation(j, log_j, poisson).psi

    @staticmethod
    def invariants(
        F: Float[Tensor, "*batch 3 3"],
    ) -> tuple[Float[Tensor, "*batch"], Float[Tensor, "*batch"], Float[Tensor, "*batch"]]:
        """Return I1, I2 and J."""
        return _invariants(F)

    def _derivatives(self, F: Tensor, poisson: Scalars) -> InvariantDerivatives:
        """All derivatives at F, the two parts together."""
        i1, i2, j = _invariants(F)
        log_j = torch.log(j)
        shape = self.distortion(i1, i2, j, log_j, poisson)
        volume = self.dilatation(j, log_j, poisson)
        total = shape._replace(dj=shape.dj + volume.dj, djj=shape.djj + volume.djj)
        return InvariantDerivatives(*(_spread(d, j) for d in total))

    def stress(
        self, F: Float[Tensor, "*batch 3 3"], poisson: Scalars
    ) -> Float[Tensor, "*batch 3 3"]:
        """First Piola-Kirchhoff stress per unit modulus, d psi1 / dF."""
        d = self._derivatives(F, poisson)
        return _combine(F, d.d1, d.d2, d.dj)

    def averaged_stress(
        self,
        F: Float[Tensor, "*cases m q 3 3"],
        weights: Float[Tensor, "m q"],
        poisson: Scalars,
    ) -> Float[Tensor, "*cases m q 3 3"]:
        """Stress per unit modulus with the dilatation taken at the element's mean J."""
        i1, i2, j = _invariants(F)
        mean = (weights * j).sum(-1) / weights.sum(-1)
        per_point = poisson[..., None] if getattr(poisson, "ndim", 0) else poisson
        d = self.distortion(i1, i2, j, torch.log(j), per_point)
        pressure = _spread(self.dilatation(mean, torch.log(mean), poisson).dj, mean)
        return _combine(F, _spread(d.d1, j), _spread(d.d2, j), d.dj + pressure[..., None])

    def tangent(
        self, F: Float[Tensor, "*batch 3 3"], poisson: Scalars
    ) -> Float[Tensor, "*batch 3 3 3 3"]:
        """Tangent per unit modulus, d P_iI / d F_jJ at [i, I, j, J]."""
        d = self._derivatives(F, poisson)
        g = torch.stack(_invariant_gradients(F), dim=-3)
        mixed = torch.stack(
            [d.d11, d.d12, d.d1j, d.d12, d.d22, d.d2j, d.d1j, d.d2j, d.djj], dim=-1
        ).unflatten(-1, (3, 3))
        outer = torch.einsum("...aiI,...ab,...bjJ->...iIjJ", g, mixed, g)
        h1, h2, hj = _invariant_hessians(F)
        weight = [x[..., None, None, None, None] for x in (d.d1, d.d2, d.dj)]
        return outer + weight[0] * h1 + weight[1] * h2 + weight[2] * hj


def _spread(value: Scalars, like: Tensor) -> Tensor:
    return torch.as_tensor(value, dtype=like.dtype, device=like.device).expand(like.shape)


def _combine(F: Tensor, d1: Tensor, d2: Tensor, dj: Tensor) -> Tensor:
    """Sum of the invariants' gradients with these weights."""
    g1, g2, gj = _invariant_gradients(F)
    return d1[..., None, None] * g1 + d2[..., None, None] * g2 + dj[..., None, None] * gj


def _invariants(F: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    C = F.mT @ F
    i1 = C.diagonal(dim1=-2, dim2=-1).sum(-1)
    i2 = 0.5 * (i1 * i1 - (C * C).sum((-2, -1)))
    return i1, i2, (F[..., 0, :] * _cofactor(F)[..., 0, :]).sum(-1)


def _cofactor(F: Tensor) -> Tensor:
    """Cofactor matrix: d det F / dF, without an inverse."""
    a, b, c = F.unbind(-2)
    cross = torch.linalg.cross
    return torch.stack([cross(b, c), cross(c, a), cross(a, b)], dim=-2)


def _invariant_gradients(F: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Gradients of I1, I2, J with respect to F."""
    C = F.mT @ F
    i1 = C.diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None]
    return 2.0 * F, 2.0 * (i1 * F - F @ C), _cofactor(F)


def _invariant_hessians(F: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Second derivatives of I1, I2, J with respect to F, at [i, I, j, J]."""
    one = torch.eye(3, dtype=F.dtype, device=F.device)
    identity = torch.einsum("ij,IJ->iIjJ", one, one).expand(*F.shape[:-2], 3, 3, 3, 3)
    B, C = F @ F.mT, F.mT @ F
    i1 = C.diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None, None, None]
    second = (
        2.0 * torch.einsum("...iI,...jJ->...iIjJ", F, F)
        + i1 * identity
        - torch.einsum("ij,...IJ->...iIjJ", one, C)
        - torch.einsum("...iJ,...jI->...iIjJ", F, F)
        - torch.einsum("...ij,IJ->...iIjJ", B, one)
    )
    levi = torch.zeros(3, 3, 3, dtype=F.dtype, device=F.device)
    for i in range(3):
        levi[i, (i + 1) % 3, (i + 2) % 3], levi[i, (i + 2) % 3, (i + 1) % 3] = 1.0, -1.0
    third = torch.einsum("ijk,IJK,...kK->...iIjJ", levi, levi, F)
    return 2.0 * identity, 2.0 * second, third

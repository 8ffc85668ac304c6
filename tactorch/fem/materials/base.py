"""Hyperelastic materials: a strain energy per unit of Young's modulus.

The energy density of every material is `youngs * psi(F)` at a fixed Poisson's ratio. Stress and
tangent are given per unit modulus too, and the derivative of the internal force with respect to
the modulus of an element is its unit force (eq. 11 of the paper).

A new material is a subclass of `IsotropicMaterial` with a strain energy of the invariants, or of
`Material` with an energy of F. Derivatives are computed by autograd, unless given in closed form.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from tactorch.config import Options, option

Array = Any  # a float, a NumPy array or a torch tensor; elements broadcast
Gradient = Float[Tensor, "*batch 3 3"]


def lame(poisson: Array) -> tuple[Array, Array]:
    """Return Lame's parameters (lambda, mu) for a Young's modulus of one."""
    mu = 0.5 / (1.0 + poisson)
    return 2.0 * mu * poisson / (1.0 - 2.0 * poisson), mu


def bulk(poisson: Array) -> Array:
    """Return the bulk modulus for a Young's modulus of one."""
    return 1.0 / (3.0 * (1.0 - 2.0 * poisson))


class EnergyDerivatives(NamedTuple):
    """Energy psi(I1, I2, J) per unit modulus, with its first and second derivatives."""

    psi: Array
    d1: Array = 0.0
    d2: Array = 0.0
    dj: Array = 0.0
    d11: Array = 0.0
    d12: Array = 0.0
    d1j: Array = 0.0
    d22: Array = 0.0
    d2j: Array = 0.0
    djj: Array = 0.0


@dataclass(frozen=True)
class Material(Options, ABC):
    """A hyperelastic material, given by its energy density per unit Young's modulus.

    A subclass defines `energy` in torch operations. Its further fields, declared by
    `tactorch.config.option`, are the parameters of the material.

    Attributes:
        allows_inversion: Whether the energy is finite for det F <= 0.
    """

    section: ClassVar[str] = "material"
    allows_inversion: ClassVar[bool] = False

    poisson: float = option(
        0.45, "Poisson's ratio; soft tissue and silicone have 0.45 to 0.499", gt=-1.0, lt=0.5
    )

    @abstractmethod
    def energy(self, F: Gradient, poisson: Array) -> Float[Tensor, "*batch"]:
        """Return the energy density per unit modulus, at deformation gradients (dimensionless).

        Poisson's ratio is one for all, or one for each deformation gradient.
        """

    def stress(self, F: Gradient, poisson: Array) -> Gradient:
        """Return the first Piola-Kirchhoff stress per unit modulus, d psi / dF."""
        return torch.func.grad(lambda A: self.energy(A, poisson).sum())(F)

    def tangent(self, F: Gradient, poisson: Array) -> Float[Tensor, "*batch 3 3 3 3"]:
        """Return the tangent per unit modulus, d P_iI / d F_jJ at [i, I, j, J]."""
        pullback = torch.func.vjp(lambda A: self.stress(A, poisson), F)[1]
        basis = torch.eye(9, dtype=F.dtype, device=F.device).reshape(9, *[1] * (F.ndim - 2), 3, 3)
        (rows,) = torch.func.vmap(pullback)(basis.expand(9, *F.shape))
        return rows.movedim(0, -3).unflatten(-3, (3, 3))


class IsotropicMaterial(Material):
    """A material given by a strain energy of the invariants of C = F^T F.

    I1 = tr C, I2 = (I1^2 - tr C^2) / 2, J = det F. A subclass defines `strain_energy`. The part
    that depends on J only may be given as `volumetric_energy` instead: elements that average the
    volume change do so with this part.
    """

    @abstractmethod
    def strain_energy(self, i1: Array, i2: Array, j: Array, log_j: Array, poisson: Array) -> Array:
        """Return the energy density per unit modulus, without `volumetric_energy`."""

    def volumetric_energy(self, j: Array, log_j: Array, poisson: Array) -> Array:
        """Return the part of the energy density that depends on J only; zero by default."""
        return 0.0 * j

    def strain_derivatives(
        self, i1: Array, i2: Array, j: Array, log_j: Array, poisson: Array
    ) -> EnergyDerivatives:
        """Return `strain_energy` with its derivatives; a subclass may give closed forms."""

        def energy(i1: Tensor, i2: Tensor, j: Tensor, poisson: Array) -> Tensor:
            return self.strain_energy(i1, i2, j, torch.log(j), poisson)

        psi, (d1, d2, dj), (h1, h2, hj) = _differentiate(energy, (i1, i2, j), poisson)
        return EnergyDerivatives(psi, d1, d2, dj, h1[0], h1[1], h1[2], h2[1], h2[2], hj[2])

    def volumetric_derivatives(self, j: Array, log_j: Array, poisson: Array) -> EnergyDerivatives:
        """Return `volumetric_energy` with its derivatives; a subclass may give closed forms."""
        if type(self).volumetric_energy is IsotropicMaterial.volumetric_energy:
            return EnergyDerivatives(0.0 * j)

        def energy(j: Tensor, poisson: Array) -> Tensor:
            return self.volumetric_energy(j, torch.log(j), poisson)

        psi, (dj,), ((djj,),) = _differentiate(energy, (j,), poisson)
        return EnergyDerivatives(psi, dj=dj, djj=djj)

    def energy(self, F: Gradient, poisson: Array) -> Float[Tensor, "*batch"]:
        """Return the energy density per unit modulus (dimensionless)."""
        i1, i2, j = invariants(F)
        shared = (j, torch.log(j), poisson)
        return self.strain_energy(i1, i2, *shared) + self.volumetric_energy(*shared)


def _differentiate(
    energy: Callable[..., Tensor], arguments: tuple[Array, ...], poisson: Array
) -> tuple[Array, tuple[Array, ...], tuple[tuple[Array, ...], ...]]:
    """Value, gradient and Hessian of an elementwise function, in the type of the arguments."""
    as_numpy = not isinstance(arguments[0], Tensor)
    if as_numpy:
        arguments = tuple(torch.as_tensor(x, dtype=torch.float64) for x in arguments)
        poisson = torch.as_tensor(poisson, dtype=torch.float64)
    which = tuple(range(len(arguments)))

    def psi(*x: Tensor) -> Tensor:
        return energy(*x, poisson) + 0.0 * x[0]  # an energy may be constant

    def total(*x: Tensor) -> Tensor:
        return psi(*x).sum()

    first, pullback = torch.func.vjp(torch.func.grad(total, argnums=which), *arguments)[:2]
    zeros = [torch.zeros_like(d) for d in first]
    second = tuple(
        pullback(tuple(torch.ones_like(d) if i == k else zeros[i] for i, d in enumerate(first)))
        for k in which
    )
    if not as_numpy:
        return psi(*arguments), first, second
    rows = tuple(tuple(d.numpy() for d in row) for row in second)
    return psi(*arguments).numpy(), tuple(d.numpy() for d in first), rows


def invariants(F: Gradient) -> tuple[Tensor, Tensor, Tensor]:
    """Return I1, I2 and J of deformation gradients."""
    C = F.mT @ F
    i1 = C.diagonal(dim1=-2, dim2=-1).sum(-1)
    i2 = 0.5 * (i1 * i1 - (C * C).sum((-2, -1)))
    a, b, c = F.unbind(-2)  # the triple product: det's second derivative is not finite at rest
    return i1, i2, (a * torch.linalg.cross(b, c)).sum(-1)

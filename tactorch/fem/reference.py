"""The mechanics in torch operations, differentiable to any order.

The compiled kernels are tested against these functions, which also give second derivatives.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from tactorch.fem.elements import Discretisation
from tactorch.fem.materials import IsotropicMaterial, Material
from tactorch.fem.materials.base import invariants


def deformation_gradient(
    discretisation: Discretisation,
    u: Float[Tensor, "*cases nodes 3"],
    gradients: Float[Tensor, "m q k 3"],
) -> Float[Tensor, "*cases m q 3 3"]:
    """Return F = I + sum over nodes of u (x) g, at every quadrature point."""
    nodes = torch.from_numpy(discretisation.nodes)
    one = torch.eye(3, dtype=u.dtype)
    return one + torch.einsum("...mki,mqkI->...mqiI", u[..., nodes, :], gradients)


def _energy(
    material: Material, averaged: bool, F: Tensor, weights: Tensor, poisson: Tensor
) -> Float[Tensor, "*cases m"]:
    """Energy of each element per unit modulus, mm^3."""
    per_point = poisson[..., None] if poisson.ndim else poisson
    if not (averaged and isinstance(material, IsotropicMaterial)):
        return (weights * material.energy(F, per_point)).sum(-1)
    i1, i2, j = invariants(F)
    volumes = weights.sum(-1)
    mean = (weights * j).sum(-1) / volumes
    strain = material.strain_energy(i1, i2, j, torch.log(j), per_point)
    volume = material.volumetric_energy(mean, torch.log(mean), poisson)
    return (weights * strain).sum(-1) + volumes * volume


def element_energy(
    discretisation: Discretisation,
    material: Material,
    u: Float[Tensor, "*cases nodes 3"],
    poisson: Float[Tensor, "*m"],
    points: Float[Tensor, "n 3"],
) -> Float[Tensor, "*cases m"]:
    """Return the energy of each element per unit modulus, mm^3 (eq. 2 over its volume)."""
    gradients, weights = discretisation.geometry(points)
    F = deformation_gradient(discretisation, u, gradients)
    return _energy(material, discretisation.element.mean_dilatation, F, weights, poisson)


def _weighted_stress(
    discretisation: Discretisation,
    material: Material,
    u: Tensor,
    poisson: Tensor,
    points: Tensor,
) -> tuple[Float[Tensor, "*cases m q 3 3"], Float[Tensor, "m q k 3"]]:
    """Stress per unit modulus times the quadrature volumes, mm^3; shape gradients, 1/mm."""
    gradients, weights = discretisation.geometry(points)
    averaged = discretisation.element.mean_dilatation
    F = deformation_gradient(discretisation, u, gradients)

    def total(F: Tensor) -> Tensor:
        return _energy(material, averaged, F, weights, poisson).sum()

    return torch.func.grad(total)(F), gradients


def element_work(
    discretisation: Discretisation,
    material: Material,
    u: Float[Tensor, "*cases nodes 3"],
    v: Float[Tensor, "*cases nodes 3"],
    poisson: Float[Tensor, "*m"],
    points: Float[Tensor, "n 3"],
) -> Float[Tensor, "*cases m"]:
    """Return the virtual work of each element's unit force (eq. 11) on `v`, mm^3."""
    stress, gradients = _weighted_stress(discretisation, material, u, poisson, points)
    nodes = torch.from_numpy(discretisation.nodes)
    change = torch.einsum("...mki,mqkI->...mqiI", v[..., nodes, :], gradients)
    return (stress * change).sum((-3, -2, -1))


def internal_force(
    discretisation: Discretisation,
    material: Material,
    u: Float[Tensor, "*cases nodes 3"],
    youngs: Float[Tensor, " m"],
    poisson: Float[Tensor, "*m"],
    points: Float[Tensor, "n 3"],
) -> Float[Tensor, "*cases nodes 3"]:
    """Return the nodal elastic forces, N."""
    stress, gradients = _weighted_stress(discretisation, material, u, poisson, points)
    blocks = torch.einsum("m,...mqiI,mqkI->...mki", youngs, stress, gradients)
    nodes = torch.from_numpy(discretisation.nodes).reshape(-1)
    return torch.zeros_like(u).index_add(u.ndim - 2, nodes, blocks.flatten(-3, -2))

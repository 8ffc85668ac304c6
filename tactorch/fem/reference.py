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
    nodes = torch.from_numpy(discretisation.nodes).to(u.device)
    one = torch.eye(3, dtype=u.dtype, device=u.device)
    return one + torch.einsum("...mki,mqkI->...mqiI", u[..., nodes, :], gradients)


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
    per_point = poisson[..., None] if poisson.ndim else poisson
    averaged = discretisation.element.mean_dilatation and isinstance(material, IsotropicMaterial)
    if not averaged:
        return (weights * material.energy(F, per_point)).sum(-1)
    assert isinstance(material, IsotropicMaterial)
    i1, i2, j = invariants(F)
    volumes = weights.sum(-1)
    mean = (weights * j).sum(-1) / volumes
    strain = material.strain_energy(i1, i2, j, torch.log(j), per_point)
    volume = material.volumetric_energy(mean, torch.log(mean), poisson)
    return (weights * strain).sum(-1) + volumes * volume


def element_work(
    discretisation: Discretisation,
    material: Material,
    u: Float[Tensor, "*cases nodes 3"],
    v: Float[Tensor, "*cases nodes 3"],
    poisson: Float[Tensor, "*m"],
    points: Float[Tensor, "n 3"],
) -> Float[Tensor, "*cases m"]:
    """Return the virtual work of each element's unit force (eq. 11) on `v`, mm^3."""
    gradients, weights = discretisation.geometry(points)
    F = deformation_gradient(discretisation, u, gradients)
    one = torch.eye(3, dtype=u.dtype, device=u.device)
    change = deformation_gradient(discretisation, v, gradients) - one
    per_point = poisson[..., None] if poisson.ndim else poisson
    averaged = discretisation.element.mean_dilatation and isinstance(material, IsotropicMaterial)
    if not averaged:
        return (weights * (material.stress(F, per_point) * change).sum((-2, -1))).sum(-1)
    assert isinstance(material, IsotropicMaterial)
    stress = material.averaged_stress(F, weights, poisson)
    return (weights * (stress * change).sum((-2, -1))).sum(-1)


def internal_force(
    discretisation: Discretisation,
    material: Material,
    u: Float[Tensor, "*cases nodes 3"],
    youngs: Float[Tensor, " m"],
    poisson: Float[Tensor, "*m"],
    points: Float[Tensor, "n 3"],
) -> Float[Tensor, "*cases nodes 3"]:
    """Return the nodal elastic forces, N: the work of the elements on unit displacements."""
    gradients, weights = discretisation.geometry(points)
    F = deformation_gradient(discretisation, u, gradients)
    per_point = poisson[..., None] if poisson.ndim else poisson
    if discretisation.element.mean_dilatation and isinstance(material, IsotropicMaterial):
        stress = material.averaged_stress(F, weights, poisson)
    else:
        stress = material.stress(F, per_point)
    scaled = weights * youngs[:, None]
    blocks = torch.einsum("mq,...mqiI,mqkI->...mki", scaled, stress, gradients)
    nodes = torch.from_numpy(discretisation.nodes).to(u.device).reshape(-1)
    out = torch.zeros_like(u)
    return out.index_add(u.ndim - 2, nodes, blocks.flatten(-3, -2))

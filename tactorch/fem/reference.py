"""The mechanics in torch operations, differentiable to any order.

The compiled kernels are tested against these functions, which also give second derivatives.
Poisson's ratio and the rest positions (mm) are those of the body unless given.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from tactorch.fem.assembly import Assembly
from tactorch.fem.elements import Discretisation
from tactorch.fem.materials import IsotropicMaterial
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


def element_energy(
    body: Assembly,
    u: Float[Tensor, "*cases nodes 3"],
    poisson: Float[Tensor, "*m"] | None = None,
    points: Float[Tensor, "n 3"] | None = None,
) -> Float[Tensor, "*cases m"]:
    """Return the energy of each element per unit modulus, mm^3 (eq. 2 over its volume)."""
    gradients, weights = body.discretisation.geometry(_points(body, points))
    return _energy(body, deformation_gradient(body.discretisation, u, gradients), weights, poisson)


def element_work(
    body: Assembly,
    u: Float[Tensor, "*cases nodes 3"],
    v: Float[Tensor, "*cases nodes 3"],
    poisson: Float[Tensor, "*m"] | None = None,
    points: Float[Tensor, "n 3"] | None = None,
) -> Float[Tensor, "*cases m"]:
    """Return the virtual work of each element's unit force (eq. 11) on `v`, mm^3."""
    gradients, weights = body.discretisation.geometry(_points(body, points))
    F = deformation_gradient(body.discretisation, u, gradients)
    stress = torch.func.grad(lambda F: _energy(body, F, weights, poisson).sum())(F)
    nodes = torch.from_numpy(body.discretisation.nodes)
    change = torch.einsum("...mki,mqkI->...mqiI", v[..., nodes, :], gradients)
    return (stress * change).sum((-3, -2, -1))


def _points(body: Assembly, points: Tensor | None) -> Tensor:
    return torch.tensor(body.points) if points is None else points


def _energy(
    body: Assembly, F: Tensor, weights: Tensor, poisson: Tensor | None
) -> Float[Tensor, "*cases m"]:
    """Energy of each element per unit modulus, mm^3."""
    if poisson is None:
        poisson = torch.as_tensor(body.poisson, dtype=torch.float64)
    per_point = poisson[..., None] if poisson.ndim else poisson
    material = body.material
    averaged = body.discretisation.element.mean_dilatation
    if not (averaged and isinstance(material, IsotropicMaterial)):
        return (weights * material.energy(F, per_point)).sum(-1)
    i1, i2, j = invariants(F)
    volumes = weights.sum(-1)
    mean = (weights * j).sum(-1) / volumes
    strain = material.strain_energy(i1, i2, j, torch.log(j), per_point)
    volume = material.volumetric_energy(mean, torch.log(mean), poisson)
    return (weights * strain).sum(-1) + volumes * volume

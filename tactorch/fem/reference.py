"""The mechanics in torch operations, differentiable to any order.

They give second derivatives, and the compiled kernels are tested against them.
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


def element_work(
    body: Assembly,
    u: Float[Tensor, "*cases nodes 3"],
    v: Float[Tensor, "*cases nodes 3"],
    poisson: Float[Tensor, "*m"] | None = None,
    points: Float[Tensor, "n 3"] | None = None,
    *,
    per_point: bool = False,
) -> Float[Tensor, "*values"]:
    """Return the virtual work of each element's unit force (eq. 11) on `v`, mm^3.

    With `per_point` it is that of each quadrature point's unit force.
    """
    rest = torch.tensor(body.points) if points is None else points
    gradients, weights = body.discretisation.geometry(rest)
    F = deformation_gradient(body.discretisation, u, gradients)
    mean = _mean_dilatation(F, weights)

    def energy(F: Tensor, mean: Tensor) -> Tensor:
        return _energy(body, F, mean, weights, poisson).sum()

    stress, slope = torch.func.grad(energy, argnums=(0, 1))(F, mean)
    nodes = torch.from_numpy(body.discretisation.nodes)
    change = torch.einsum("...mki,mqkI->...mqiI", v[..., nodes, :], gradients)
    work = (stress * change).sum((-2, -1))
    if body.averages_volume:
        rate = torch.func.grad(lambda F: _mean_dilatation(F, weights)[..., 0].sum())(F)
        work = work + slope * (rate * change).sum((-3, -2, -1))[..., None]
    return work if per_point else work.sum(-1)


def _mean_dilatation(F: Tensor, weights: Tensor) -> Float[Tensor, "*cases m q"]:
    """Mean of J over each element, repeated for its quadrature points."""
    mean = (weights * invariants(F)[2]).sum(-1, keepdim=True) / weights.sum(-1, keepdim=True)
    return mean.expand(F.shape[:-2])


def _energy(
    body: Assembly, F: Tensor, mean: Tensor, weights: Tensor, poisson: Tensor | None
) -> Float[Tensor, "*cases m q"]:
    """Energy of each quadrature point per unit modulus, mm^3."""
    if poisson is None:
        poisson = torch.as_tensor(body.poisson, dtype=torch.float64)
    per_point = poisson[..., None] if poisson.ndim else poisson
    material = body.material
    if not isinstance(material, IsotropicMaterial) or not body.averages_volume:
        return weights * material.energy(F, per_point) + 0.0 * mean
    i1, i2, j = invariants(F)
    strain = material.strain_energy(i1, i2, j, torch.log(j), per_point)
    return weights * (strain + material.volumetric_energy(mean, torch.log(mean), per_point))

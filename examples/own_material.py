"""Add a material: a solid that stiffens as it is stretched.

The strain energy is Fung's exponential in I1, with the volumetric terms of the paper:

    psi = mu / (2 b) (exp(b (I1 - 3)) - 1) - mu ln J + lambda / 2 (ln J)^2,   per unit modulus

The energy is all that is given; stress and tangent follow by autograd. For small b the material is
the Neo-Hookean solid.
"""

from dataclasses import dataclass

import numpy as np
import torch

from tactorch import SoftBody, Supports, make_material
from tactorch.config import option
from tactorch.fem import MATERIALS, Material
from tactorch.fem.materials import IsotropicMaterial, lame
from tactorch.mesh import box_mesh, face_nodes


@dataclass(frozen=True)
class Fung(IsotropicMaterial):
    """Exponential in I1."""

    b: float = option(1.0, "Rate of stiffening", gt=0)

    def strain_energy(
        self,
        i1: torch.Tensor,
        i2: torch.Tensor,
        j: torch.Tensor,
        log_j: torch.Tensor,
        poisson: float | torch.Tensor,
    ) -> torch.Tensor:
        """Return the energy density per unit modulus, without the volumetric part."""
        _, mu = lame(poisson)
        return 0.5 * mu / self.b * torch.expm1(self.b * (i1 - 3.0)) - mu * log_j

    def volumetric_energy(
        self, j: torch.Tensor, log_j: torch.Tensor, poisson: float | torch.Tensor
    ) -> torch.Tensor:
        """Return lambda / 2 (ln J)^2."""
        lam, _ = lame(poisson)
        return 0.5 * lam * log_j**2


MATERIALS.register("fung", Fung)  # recordings and `make_material` refer to it by this name


def derivative_error(material: Material) -> float:
    """Return the largest error of stress and tangent against difference quotients."""
    torch.manual_seed(0)
    F = torch.eye(3, dtype=torch.float64) + 0.2 * torch.randn(20, 3, 3, dtype=torch.float64)
    F = F[torch.linalg.det(F) > 0.3]
    direction, step = torch.randn_like(F), 1e-5
    low, high = F - step * direction, F + step * direction
    nu = material.poisson
    slope = (material.energy(high, nu) - material.energy(low, nu)) / (2.0 * step)
    bend = (material.stress(high, nu) - material.stress(low, nu)) / (2.0 * step)
    first = (material.stress(F, nu) * direction).sum((-2, -1))
    second = torch.einsum("qiIjJ,qjJ->qiI", material.tangent(F, nu), direction)
    errors = ((first - slope) / slope.abs().max(), (second - bend) / bend.abs().max())
    return max(error.abs().max().item() for error in errors)


def stretch(name: str, traction_mpa: float, **parameters: float) -> float:
    """Return the stretch of a unit cube with E = 1 MPa under a nominal traction."""
    mesh = box_mesh(1.0, 2)
    body = SoftBody(mesh, make_material(name, poisson=0.45, **parameters))
    forces = body.traction("z+", [0.0, 0.0, traction_mpa]).numpy()
    rollers = Supports(fixed=mesh.points < 1e-9)
    result = body.equilibrate(np.ones(mesh.n_tets), forces, rollers).require()
    return 1.0 + float(result.displacement[face_nodes(mesh, "z+"), 2].mean())


def main() -> dict[str, float]:
    """Check the derivatives of the material, and stretch a cube."""
    results = {
        "derivatives": derivative_error(make_material("fung", 0.45, b=2.0)),
        "neo_hookean": stretch("neo_hookean", 0.5),
        "fung, b = 1e-6": stretch("fung", 0.5, b=1e-6),
        "fung, b = 2": stretch("fung", 0.5, b=2.0),
    }
    print(f"stress and tangent against difference quotients: error {results['derivatives']:.1e}")
    for name in ("neo_hookean", "fung, b = 1e-6", "fung, b = 2"):
        print(f"{name:<15} stretch {results[name]:.6f} under 0.5 MPa")
    return results


if __name__ == "__main__":
    main()

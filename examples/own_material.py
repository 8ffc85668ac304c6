"""Bring a material of your own: one that stiffens as it is stretched.

The law is Fung's exponential in I1, with the paper's volume terms:

    psi = mu / (2 b) (exp(b (I1 - 3)) - 1) - mu ln J + lambda / 2 (ln J)^2,   per unit modulus

It is written as a function of the invariants with its derivatives, in plain arithmetic; the same
lines serve the compiled kernels, autograd and CUDA. For small b it is the Neo-Hookean solid.
"""

from dataclasses import dataclass

import numpy as np
import torch

from tactorch import SoftBody, Supports, make_material
from tactorch.fem.materials import MATERIALS, Dilatation, InvariantDerivatives, IsotropicMaterial
from tactorch.fem.materials.base import Scalars, lame
from tactorch.mesh import box_mesh, face_nodes


@dataclass(frozen=True)
class Fung(IsotropicMaterial):
    """Exponential in I1.

    Attributes:
        b: How fast it stiffens; above 0.
    """

    b: float = 1.0

    def distortion(
        self, i1: Scalars, i2: Scalars, j: Scalars, log_j: Scalars, poisson: Scalars
    ) -> InvariantDerivatives:
        """Energy and derivatives of the part that is not `dilatation`."""
        _, mu = lame(poisson)
        # An exponential of any kind of number: floats, NumPy arrays, tensors.
        grown = np.e ** (self.b * (i1 - 3.0))
        return InvariantDerivatives(
            psi=0.5 * mu / self.b * (grown - 1.0) - mu * log_j,
            d1=0.5 * mu * grown,
            dj=-mu / j,
            d11=0.5 * mu * self.b * grown,
            djj=mu / (j * j),
        )

    def dilatation(self, j: Scalars, log_j: Scalars, poisson: Scalars) -> Dilatation:
        """Return lambda / 2 (ln J)^2 and its derivatives."""
        lam, _ = lame(poisson)
        return Dilatation(
            psi=0.5 * lam * log_j * log_j, dj=lam * log_j / j, djj=lam * (1.0 - log_j) / (j * j)
        )


MATERIALS["fung"] = Fung  # from here on known by name: to recordings, and to `make_material`


def error_of_derivatives(material: IsotropicMaterial) -> float:
    """Return by how much stress and tangent differ from autograd's, at random deformations."""
    torch.manual_seed(0)
    F = torch.eye(3, dtype=torch.float64) + 0.2 * torch.randn(20, 3, 3, dtype=torch.float64)
    F = F[torch.linalg.det(F) > 0.3].requires_grad_()
    energy = material.energy(F, material.poisson).sum()
    (stress,) = torch.autograd.grad(energy, F, create_graph=True)
    off = [(stress - material.stress(F, material.poisson)).abs().max().item()]
    tangent = material.tangent(F, material.poisson)
    for i in range(3):
        for k in range(3):
            (row,) = torch.autograd.grad(stress[:, i, k].sum(), F, retain_graph=True)
            off.append((row - tangent[:, i, k]).abs().max().item())
    return max(off)


def stretch(name: str, traction_mpa: float, **parameters: float) -> float:
    """Return the stretch of a unit cube with E = 1 MPa under a nominal traction."""
    mesh = box_mesh(1.0, 2)
    body = SoftBody(mesh, make_material(name, poisson=0.45, **parameters))
    forces = body.traction("z+", [0.0, 0.0, traction_mpa]).numpy()
    rollers = Supports(fixed=mesh.points < 1e-9)
    found = body.equilibrate(np.ones(mesh.n_tets), forces, rollers).require()
    return 1.0 + float(found.displacement[face_nodes(mesh, "z+"), 2].mean())


def main() -> dict[str, float]:
    """Check the law's derivatives, and pull."""
    found = {
        "derivatives": error_of_derivatives(make_material("fung", 0.45, b=2.0)),
        "neo_hookean": stretch("neo_hookean", 0.5),
        "fung, b = 1e-6": stretch("fung", 0.5, b=1e-6),
        "fung, b = 2": stretch("fung", 0.5, b=2.0),
    }
    print(f"stress and tangent against autograd: off by {found['derivatives']:.1e}")
    for name in ("neo_hookean", "fung, b = 1e-6", "fung, b = 2"):
        print(f"{name:<15} stretch {found[name]:.6f} under 0.5 MPa")
    return found


if __name__ == "__main__":
    main()

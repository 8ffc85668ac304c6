"""Differentiate a press with respect to everything: one adjoint solve, second derivatives too.

How does the mean displacement of the top answer to the modulus of each element, to Poisson's ratio
and to the pressure? Reverse mode gives all of it at once; a difference quotient and the exact
answer for a uniform cube check it.
"""

import torch

from tactorch import SoftBody, Supports, make_material
from tactorch.mesh import box_mesh, face_nodes

# Of the stretch with respect to Young's modulus, E = 1, nu = 0.45, pressure 0.2; exact.
EXACT_SLOPE = 0.138215681


def main() -> dict[str, float]:
    """Differentiate the mean displacement of the top of a unit cube."""
    mesh = box_mesh(1.0, 3)
    body = SoftBody(mesh, make_material("neo_hookean", 0.45))
    rollers = Supports(fixed=mesh.points < 1e-9)
    top = torch.from_numpy(face_nodes(mesh, "z+"))

    def mean_top(
        youngs: torch.Tensor, poisson: torch.Tensor, pressure: torch.Tensor
    ) -> torch.Tensor:
        """Mean displacement of the top along z, mm."""
        forces = body.pressure("z+", pressure)
        return body.solve(youngs, forces, rollers, poisson=poisson)[top, 2].mean()

    youngs = torch.ones(mesh.n_tets, dtype=torch.float64, requires_grad=True)  # MPa
    poisson = torch.tensor(0.45, dtype=torch.float64, requires_grad=True)
    pressure = torch.tensor(0.2, dtype=torch.float64, requires_grad=True)  # MPa
    moved = mean_top(youngs, poisson, pressure)
    by_youngs, by_poisson, by_pressure = torch.autograd.grad(
        moved, (youngs, poisson, pressure), create_graph=True
    )
    # The derivative of a derivative is one more call.
    (bend,) = torch.autograd.grad(by_pressure, pressure)

    step = 1e-4
    ends = [mean_top(youngs, poisson, pressure + sign * step) for sign in (-1.0, 1.0)]
    quotient = (ends[1] - ends[0]) / (2.0 * step)
    found = {
        "by_youngs": by_youngs.sum().item(),
        "by_poisson": by_poisson.item(),
        "by_pressure": by_pressure.item(),
        "by_pressure_quotient": quotient.item(),
        "bend": bend.item(),
    }
    print(f"by Young's modulus, all elements: {found['by_youngs']:.9f} (exact {EXACT_SLOPE})")
    print(f"by Poisson's ratio: {found['by_poisson']:.6f}")
    print(f"by pressure: {found['by_pressure']:.6f} (quotient {found['by_pressure_quotient']:.6f})")
    print(f"by pressure, twice: {found['bend']:.6f}")
    return found


if __name__ == "__main__":
    main()

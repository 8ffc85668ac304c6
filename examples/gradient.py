"""Differentiate a press with respect to its parameters, to second order.

Reverse mode gives the derivatives of the mean displacement of the top by the modulus of each
element, Poisson's ratio and the pressure with one adjoint solve. They are compared with a
difference quotient and with the exact derivative for a uniform cube.
"""

import torch

from tactorch import SoftBody, Supports, make_material
from tactorch.mesh import box_mesh, face_nodes

# Exact derivative of the stretch by Young's modulus at E = 1, nu = 0.45, pressure 0.2.
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
    displacement = mean_top(youngs, poisson, pressure)
    by_youngs, by_poisson, by_pressure = torch.autograd.grad(
        displacement, (youngs, poisson, pressure), create_graph=True
    )
    # A second derivative is one more call.
    (curvature,) = torch.autograd.grad(by_pressure, pressure)

    step = 1e-4
    ends = [mean_top(youngs, poisson, pressure + sign * step) for sign in (-1.0, 1.0)]
    quotient = (ends[1] - ends[0]) / (2.0 * step)
    results = {
        "by_youngs": by_youngs.sum().item(),
        "by_poisson": by_poisson.item(),
        "by_pressure": by_pressure.item(),
        "by_pressure_quotient": quotient.item(),
        "curvature": curvature.item(),
    }
    print(f"by Young's modulus, all elements: {results['by_youngs']:.9f} (exact {EXACT_SLOPE})")
    print(f"by Poisson's ratio: {results['by_poisson']:.6f}")
    quotient_text = f"quotient {results['by_pressure_quotient']:.6f}"
    print(f"by pressure: {results['by_pressure']:.6f} ({quotient_text})")
    print(f"by pressure, twice: {results['curvature']:.6f}")
    return results


if __name__ == "__main__":
    main()

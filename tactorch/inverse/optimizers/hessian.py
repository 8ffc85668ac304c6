"""What Gauss-Newton leaves out of the Hessian: products with it by a second adjoint.

With K l = S^T w (w the residuals' weights), the gradient of the misfit by the moduli is
g = -U(u)^T l, U = dR/de the elements' unit forces. Along a change d of the moduli, u moves by
v = -K^-1 U d, and the change of g beyond that of J^T J is

    -(DU[v])^T l + U^T K^-1 DK[d, v] l,

where DK[d, v] is the change of the tangent by the moduli and by the displacement. Both come from
the virtual work of the elements on l by differentiating it in torch. One solve a product and press
is added to the two of Gauss-Newton.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from tactorch.fem import reference
from tactorch.fem.sensitivity import Sensitivity
from tactorch.inverse.objective import Point


@dataclass(frozen=True, eq=False)
class SecondOrder:
    """The second-order part of the misfit's Hessian at a point, for a map without unknowns.

    Attributes:
        point: Where.
    """

    point: Point

    @cached_property
    def _slope(self) -> Float[np.ndarray, " m"]:
        return self.point.objective.parameterization.slope(self.point.x)

    @cached_property
    def _bend(self) -> Float[np.ndarray, " m"]:
        """Gradient by the moduli times d^2 youngs / d x^2."""
        second = self.point.objective.parameterization.second_derivative(self.point.x)
        return self.point.data_gradient / self._slope * second

    @cached_property
    def _adjoints(self) -> list[Float[np.ndarray, "nodes 3"]]:
        return self.point.evaluation.adjoints(self.point.evaluation.residuals)

    def product(self, change: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Return the second-order part times a change of x."""
        evaluation = self.point.evaluation
        moduli = self._slope * change
        parts = [
            _press(sensitivity, u, self._adjoints[i], self.point.youngs, moduli)
            for i, (sensitivity, u) in enumerate(
                zip(evaluation.sensitivities, evaluation.displacements, strict=True)
            )
        ]
        return self._slope * np.sum(parts, axis=0) + self._bend * change


def _press(
    sensitivity: Sensitivity,
    u: Float[np.ndarray, "nodes 3"],
    adjoint: Float[np.ndarray, "nodes 3"],
    youngs: Float[np.ndarray, " m"],
    change: Float[np.ndarray, " m"],
) -> Float[np.ndarray, " m"]:
    """One press's second-order change of the gradient by the moduli, 1/MPa^2 times MPa."""
    moved = torch.from_numpy(sensitivity.displacement_change(change))
    by_u, by_moduli = _work_changes(sensitivity, u, adjoint, youngs, change, moved)
    back = sensitivity.tangent.solve(by_u.numpy().ravel()).reshape(-1, 3)
    return sensitivity.unit_work(back) - by_moduli.numpy()


def _work_changes(
    sensitivity: Sensitivity,
    u: Float[np.ndarray, "nodes 3"],
    adjoint: Float[np.ndarray, "nodes 3"],
    youngs: Float[np.ndarray, " m"],
    change: Float[np.ndarray, " m"],
    moved: Float[Tensor, "nodes 3"],
) -> tuple[Float[Tensor, "nodes 3"], Float[Tensor, " m"]]:
    """DK[d, v] l, N; and the change of each element's unit work on l by v."""
    assembly = sensitivity.assembly
    ratio = torch.as_tensor(assembly.poisson, dtype=torch.float64)
    points, weights = torch.tensor(assembly.points), torch.from_numpy(adjoint)
    field = torch.tensor(u, requires_grad=True)
    moduli = torch.tensor(youngs, requires_grad=True)
    with torch.enable_grad():
        work = reference.element_work(
            assembly.discretisation, assembly.material, field, weights, ratio, points
        )
        (force,) = torch.autograd.grad((work * moduli).sum(), field, create_graph=True)
        along = (force * moved).sum() + (work * torch.from_numpy(change)).sum()
        by_u, by_moduli = torch.autograd.grad(along, (field, moduli))
    return by_u, by_moduli

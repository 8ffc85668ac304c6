"""What Gauss-Newton leaves out of the Hessian: products with it by a second adjoint.

See `tactorch.fem.Linearization.second_order`. A product takes one solve a press more than the two
of Gauss-Newton.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from tactorch.inverse.objective import Point
from tactorch.inverse.parameterization import Log


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
        """Gradient by the moduli times d^2 youngs / d x^2; only exp bends."""
        if not isinstance(self.point.objective.parameterization, Log):
            return np.zeros_like(self.point.x)
        return self.point.data_gradient / self._slope * self.point.youngs

    @cached_property
    def _adjoints(self) -> list[Float[np.ndarray, "nodes 3"]]:
        return self.point.evaluation.adjoints(self.point.evaluation.residuals)

    def product(self, change: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Return the second-order part times a change of x."""
        sensitivities = self.point.evaluation.sensitivities
        parts = [
            sensitivity.linearization.second_order(adjoint, self._slope * change)
            for sensitivity, adjoint in zip(sensitivities, self._adjoints, strict=True)
        ]
        return self._slope * np.sum(parts, axis=0) + self._bend * change

"""The weight of the prior, chosen without the truth: cooled until the data are fitted.

Discrepancy principle (Morozov, 1966): lower the weight until the mean squared residual reaches
one, that is, the noise, and no further.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tactorch.inverse.objective import Objective

_FAST, _SLOW = 1.0 / 3.0, 0.6
_NEAR = 10.0  # mean squared residual below which the weight is lowered slowly
_EXHAUSTED = 1e-12
_RULE = 10.0


@dataclass
class Cooling:
    """A weight that falls, or stays where it was given.

    Attributes:
        weight: Present weight.
        first: Weight at the start.
        fixed: Whether it was given.
    """

    weight: float
    first: float
    fixed: bool

    @staticmethod
    def start(
        objective: Objective,
        x: Float[np.ndarray, " m"],
        weight: float | None,
        state: dict[str, float],
    ) -> "Cooling":
        """Take the given weight, a resumed one, or one at which the prior rules."""
        if objective.prior.name == "none":
            return Cooling(0.0, 0.0, True)
        if weight is not None:
            return Cooling(weight, weight, True)
        if "weight" in state:
            return Cooling(state["weight"], state["first_weight"], False)
        first = ruling_weight(objective, x)
        return Cooling(first, first, False)

    def state(self) -> dict[str, float]:
        """Numbers from which to resume."""
        return {"weight": self.weight, "first_weight": self.first}

    def lower(self, chi2: float) -> str:
        """Lower the weight; the reason to stop instead, if there is one."""
        if chi2 <= 1.0:
            return "the data are fitted to their noise"
        if self.weight < _EXHAUSTED * self.first:
            return (
                "the prior is exhausted and the data are not fitted to their noise: the noise is "
                "larger than stated, or the model is wrong"
            )
        self.weight *= _FAST if chi2 > _NEAR else _SLOW
        return ""


def ruling_weight(objective: Objective, x: Float[np.ndarray, " m"]) -> float:
    """A weight at which the prior outweighs the data: ten times the balance of the diagonals."""
    point = objective.at(x)
    data = np.einsum("ij,ij->", point.jacobian, point.jacobian)
    prior = point.penalty_curvature.diagonal().sum()
    return _RULE * float(data / prior)

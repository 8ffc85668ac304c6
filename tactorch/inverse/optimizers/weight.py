"""The weight of the prior, chosen without the truth: cooled until the data are fitted.

Discrepancy principle (Morozov, 1966): lower the weight until the mean squared residual reaches
one, that is, the noise, and no further.
"""

from dataclasses import dataclass

import numpy as np

from tactorch.inverse.objective import Point

_FAST, _SLOW = 1.0 / 3.0, 0.6
_NEAR = 10.0  # mean squared residual below which the weight is lowered slowly
_EXHAUSTED = 1e-12
_UNSTOPPED = ""
_FITTED = "the data are fitted to their noise"
_UNFITTED = (
    "the prior is exhausted and the data are not fitted to their noise: the noise is larger than "
    "stated, or the model is wrong"
)
_REASONS = (_UNSTOPPED, _FITTED, _UNFITTED)  # saved by index
_RULE = 30.0


@dataclass
class Cooling:
    """A weight that falls, or stays where it was given.

    Attributes:
        weight: Present weight.
        first: Weight at the start.
        fixed: Whether it was given.
        ended: Why it falls no further; empty while it falls, or where it was given.
    """

    weight: float
    first: float
    fixed: bool
    ended: str = _UNSTOPPED

    @staticmethod
    def start(point: Point, weight: float | None, state: dict[str, float]) -> "Cooling":
        """Take the given weight, a resumed one, or one at which the prior rules at `point`."""
        if point.objective.prior.name == "none":
            return Cooling(0.0, 0.0, True)
        if weight is not None:
            return Cooling(weight, weight, True)
        if "weight" in state:
            ended = _REASONS[int(state["ended"])]
            return Cooling(state["weight"], state["first_weight"], False, ended)
        first = ruling_weight(point)
        return Cooling(first, first, fixed=first == 0.0)

    def state(self) -> dict[str, float]:
        """Numbers from which to resume; none where the weight was given."""
        if self.fixed:
            return {}
        ended = float(_REASONS.index(self.ended))
        return {"weight": self.weight, "first_weight": self.first, "ended": ended}

    def lower(self, chi2: float) -> None:
        """Lower the weight, unless it was given, has ended or ends now."""
        if self.fixed:
            return
        if chi2 <= 1.0:
            self.ended = _FITTED  # perhaps later than the prior was exhausted
        elif self.ended:
            return
        elif self.weight < _EXHAUSTED * self.first:
            self.ended = _UNFITTED
        else:
            self.weight *= _FAST if chi2 > _NEAR else _SLOW


def ruling_weight(point: Point) -> float:
    """A weight at which the prior outweighs the data: thirty times the balance of the diagonals."""
    data = np.einsum("ij,ij->", point.jacobian, point.jacobian)
    prior = point.penalty_curvature.diagonal().sum()
    return _RULE * float(data / prior) if prior > 0 else 0.0  # a single element has no jumps

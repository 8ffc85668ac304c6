"""The paper's optimizer: truncated Newton with the adjoint gradient (Algorithm 1)."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tactorch.inverse.monitor import Monitor
from tactorch.inverse.objective import Objective
from tactorch.inverse.optimizers.base import require_positive, require_weight
from tactorch.inverse.optimizers.scipy_bounded import BoundedRun

_REASONS = {
    0: "a local minimum",
    1: "the objective no longer falls",
    2: "the parameters no longer move",
    3: "evaluation limit reached",
    4: "the line search failed",
}


@dataclass
class TNC:
    """SciPy's TNC (Nash, 1984), without a prior unless one is weighted.

    Attributes:
        max_evaluations: Limit of solves of all presses; the paper's "iterations". A resumed
            inversion counts its earlier ones.
        ftol: Change of the objective at which to stop.
        gtol: Projected gradient at which to stop.
        weight: Weight of the prior.
    """

    max_evaluations: int = 500
    ftol: float = 1e-12
    gtol: float = 1e-10
    weight: float = 0.0
    name: str = "tnc"

    def __post_init__(self) -> None:
        """Check the settings."""
        require_positive(max_evaluations=self.max_evaluations, ftol=self.ftol, gtol=self.gtol)
        require_weight(self.weight)

    def minimize(
        self, objective: Objective, start: Float[np.ndarray, " m"], monitor: Monitor
    ) -> str:
        """See `Optimizer.minimize`."""
        left = self.max_evaluations - monitor.evaluations
        if left <= 0:
            return _REASONS[3]
        run = BoundedRun(objective.at(start), monitor, self.weight)
        result = run.run("TNC", {"maxfun": left, "ftol": self.ftol, "gtol": self.gtol})
        return _REASONS.get(int(result.status), str(result.message))

"""The paper's optimizer: truncated Newton with the adjoint gradient (Algorithm 1)."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tactorch.config import option
from tactorch.inverse.monitor import Monitor
from tactorch.inverse.objective import Objective
from tactorch.inverse.optimizers.base import Optimizer
from tactorch.inverse.optimizers.scipy_bounded import BoundedRun

_REASONS = {
    0: "a local minimum",
    1: "the objective no longer falls",
    2: "the parameters no longer move",
    3: "evaluation limit reached",
    4: "the line search failed",
}


@dataclass(frozen=True)
class TNC(Optimizer):
    """SciPy's TNC (Nash, 1984), the paper's truncated Newton (Algorithm 1).

    It does not choose the weight of a prior: one that is not given counts as zero.

    Attributes:
        max_evaluations: Limit of solves of all presses; the paper's "iterations". A resumed
            inversion includes its earlier ones.
        ftol: Change of the objective at which to stop.
        gtol: Projected gradient at which to stop.
    """

    max_evaluations: int = option(500, "Limit of solves of all presses", gt=0)
    ftol: float = option(1e-12, "Change of the objective at which to stop", gt=0)
    gtol: float = option(1e-10, "Projected gradient at which to stop", gt=0)

    def minimize(
        self, objective: Objective, start: Float[np.ndarray, " m"], monitor: Monitor
    ) -> str:
        """See `Optimizer.minimize`."""
        left = self.max_evaluations - monitor.evaluations
        if left <= 0:
            return _REASONS[3]
        run = BoundedRun(objective.at(start), monitor, objective.weight or 0.0)
        result = run.run("TNC", {"maxfun": left, "ftol": self.ftol, "gtol": self.gtol})
        return _REASONS.get(int(result.status), str(result.message))

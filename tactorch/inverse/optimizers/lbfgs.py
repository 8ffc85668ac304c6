"""Limited-memory BFGS with bounds, the prior's weight lowered in stages."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tactorch.inverse.monitor import Monitor
from tactorch.inverse.objective import Objective
from tactorch.inverse.optimizers.base import require_positive, require_weight
from tactorch.inverse.optimizers.scipy_bounded import BoundedRun
from tactorch.inverse.optimizers.weight import RegularizationSchedule


@dataclass
class LBFGS:
    """SciPy's L-BFGS-B (Byrd, Lu, Nocedal and Zhu, 1995).

    Attributes:
        max_iterations: Limit over all stages.
        stage_iterations: Iterations at one weight of the prior, when it is chosen by cooling.
        memory: Number of gradient pairs.
        ftol: Relative change of the objective at which a stage ends.
        weight: Weight of the prior, or None to lower it until the data are fitted to their noise.
    """

    max_iterations: int = 500
    stage_iterations: int = 40
    memory: int = 30
    ftol: float = 1e-9
    weight: float | None = None
    name: str = "lbfgs"

    def __post_init__(self) -> None:
        """Check the settings."""
        require_positive(
            max_iterations=self.max_iterations,
            stage_iterations=self.stage_iterations,
            memory=self.memory,
            ftol=self.ftol,
        )
        require_weight(self.weight)

    def minimize(
        self, objective: Objective, start: Float[np.ndarray, " m"], monitor: Monitor
    ) -> str:
        """See `Optimizer.minimize`."""
        point = objective.at(start)
        cooling = RegularizationSchedule.start(point, self.weight, monitor.state)
        while not cooling.ended:
            monitor.state = cooling.state()
            left = self.max_iterations - monitor.iteration
            if left <= 0:
                return "iteration limit reached"
            run = BoundedRun(point, monitor, cooling.weight)
            stage = left if cooling.fixed else min(left, self.stage_iterations)
            options = {"maxiter": stage, "maxcor": self.memory, "ftol": self.ftol, "gtol": 1e-12}
            result = run.run("L-BFGS-B", options)
            point = run.point
            if cooling.fixed:
                return "iteration limit reached" if result.nit >= left else str(result.message)
            cooling.lower(point.evaluation.chi2)
        monitor.state = cooling.state()
        return cooling.ended

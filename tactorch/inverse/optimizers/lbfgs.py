"""Limited-memory BFGS with bounds, the prior's weight lowered in stages."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tactorch.config import option
from tactorch.inverse.monitor import Monitor
from tactorch.inverse.objective import Objective
from tactorch.inverse.optimizers.base import Optimizer
from tactorch.inverse.optimizers.scipy_bounded import BoundedRun
from tactorch.inverse.optimizers.weight import RegularizationSchedule


@dataclass(frozen=True)
class LBFGS(Optimizer):
    """SciPy's L-BFGS-B (Byrd, Lu, Nocedal and Zhu, 1995), the prior's weight lowered in stages.

    Attributes:
        max_iterations: Limit over all stages.
        stage_iterations: Iterations at one weight of the prior, where the weight is not given.
        memory: Number of gradient pairs.
        ftol: Relative change of the objective at which a stage ends.
    """

    max_iterations: int = option(500, "Limit of iterations over all stages", gt=0)
    stage_iterations: int = option(40, "Iterations at one weight of the prior", gt=0)
    memory: int = option(30, "Number of gradient pairs", gt=0)
    ftol: float = option(1e-9, "Relative change of the objective that ends a stage", gt=0)

    def minimize(
        self, objective: Objective, start: Float[np.ndarray, " m"], monitor: Monitor
    ) -> str:
        """See `Optimizer.minimize`."""
        point = objective.at(start)
        cooling = RegularizationSchedule.start(point, monitor.state)
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

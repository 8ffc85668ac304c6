"""Base of the optimizers."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

from tactorch.config import Options, Registry
from tactorch.inverse.fields import Vector
from tactorch.inverse.fit.monitor import Monitor, StopReason
from tactorch.inverse.fit.objective import Objective


@dataclass(frozen=True)
class Optimizer(Options, ABC):
    """Settings of an optimizer, which minimises an objective from a start."""

    section: ClassVar[str] = "optimizer"

    @abstractmethod
    def minimize(self, objective: Objective, start: Vector, monitor: Monitor) -> StopReason:
        """Minimise; the monitor holds the best parameters.

        Returns:
            The reason for stopping.

        Raises:
            ConvergenceError: the start itself has no equilibrium.
            StopOptimization: raised by the monitor.
        """


_HERE = "tactorch.inverse.fit.optimizers"
#: Settings of the optimizers by name.
OPTIMIZERS = Registry(
    "optimizer",
    {
        "gauss_newton": f"{_HERE}.gauss_newton:GaussNewton",
        "newton_cg": f"{_HERE}.newton_cg:NewtonCG",
        "tnc": f"{_HERE}.scipy_methods:TNC",
        "lbfgs": f"{_HERE}.scipy_methods:LBFGS",
    },
)

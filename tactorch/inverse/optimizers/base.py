"""Base of the optimizers."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from tactorch.config import Options
from tactorch.inverse.monitor import Monitor
from tactorch.inverse.objective import Objective


@dataclass(frozen=True)
class Optimizer(Options, ABC):
    """Settings of an optimizer, which minimises an objective from a start."""

    section: ClassVar[str] = "optimizer"

    @abstractmethod
    def minimize(
        self, objective: Objective, start: Float[np.ndarray, " m"], monitor: Monitor
    ) -> str:
        """Minimise; the monitor holds the best parameters.

        Returns:
            The reason for stopping, in words.

        Raises:
            ConvergenceError: the start itself has no equilibrium.
            StopOptimization: raised by the monitor.
        """


def projected_gradient(
    x: Float[np.ndarray, " m"],
    gradient: Float[np.ndarray, " m"],
    limits: tuple[float | np.ndarray, float | np.ndarray],
) -> Float[np.ndarray, " m"]:
    """The gradient without the components that push against a bound."""
    low, high = limits
    blocked = ((x <= low) & (gradient > 0)) | ((x >= high) & (gradient < 0))
    return np.where(blocked, 0.0, gradient)

"""Base of the optimizers."""

import logging
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from tactorch.config import Options
from tactorch.errors import ConvergenceError
from tactorch.inverse.monitor import Monitor, StopOptimization, StopReason
from tactorch.inverse.objective import Objective

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Optimizer(Options, ABC):
    """Settings of an optimizer, which minimises an objective from a start."""

    section: ClassVar[str] = "optimizer"

    @abstractmethod
    def minimize(
        self, objective: Objective, start: Float[np.ndarray, " m"], monitor: Monitor
    ) -> StopReason:
        """Minimise; the monitor holds the best parameters.

        Returns:
            The reason for stopping.

        Raises:
            ConvergenceError: the start itself has no equilibrium.
            StopOptimization: raised by the monitor.
        """

    def run(
        self, objective: Objective, start: Float[np.ndarray, " m"], monitor: Monitor
    ) -> StopReason:
        """Minimise until an end, a limit or an interruption; the monitor holds the best parameters.

        Returns:
            The reason for stopping.

        Raises:
            ConvergenceError: the start itself has no equilibrium.
            KeyboardInterrupt: Ctrl-C before the start was evaluated.
        """
        try:
            reason = self.minimize(objective, start, monitor)
        except StopOptimization as stop:
            return stop.reason
        except KeyboardInterrupt:
            if monitor.best is None:
                raise
            return StopReason.INTERRUPTED
        except ConvergenceError as error:  # an unstable equilibrium has no derivatives
            if monitor.point is None:
                raise
            _log.warning("No derivatives at the best map: %s", error)
            return StopReason.NO_DERIVATIVES
        monitor.ended = None if reason.is_limit else reason
        return reason


def projected_gradient(
    x: Float[np.ndarray, " m"],
    gradient: Float[np.ndarray, " m"],
    limits: tuple[float | np.ndarray, float | np.ndarray],
) -> Float[np.ndarray, " m"]:
    """Return the gradient without the components that push against a bound."""
    low, high = limits
    blocked = ((x <= low) & (gradient > 0)) | ((x >= high) & (gradient < 0))
    return np.where(blocked, 0.0, gradient)

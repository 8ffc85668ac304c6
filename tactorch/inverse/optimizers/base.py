"""What the optimizers share."""

from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.inverse.monitor import Monitor
from tactorch.inverse.objective import Objective


@runtime_checkable
class Optimizer(Protocol):
    """Moves parameters from a start until it has a reason to stop."""

    name: str

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
        ...


def require_positive(**values: float) -> None:
    """Refuse settings that are not above zero.

    Raises:
        ConfigError: names the setting.
    """
    for name, value in values.items():
        if not value > 0:
            raise ConfigError(f"optimizer.{name}={value} must be above 0.")


def require_weight(weight: float | None) -> None:
    """Refuse a weight of the prior that is negative or not finite.

    Raises:
        ConfigError: says so.
    """
    if weight is not None and not 0 <= weight < np.inf:
        raise ConfigError(f"optimizer.weight={weight} must be at least 0 and finite.")


def projected_gradient(
    x: Float[np.ndarray, " m"],
    gradient: Float[np.ndarray, " m"],
    limits: tuple[float | np.ndarray, float | np.ndarray],
) -> Float[np.ndarray, " m"]:
    """The gradient without the components that push against a bound."""
    low, high = limits
    blocked = ((x <= low) & (gradient > 0)) | ((x >= high) & (gradient < 0))
    return np.where(blocked, 0.0, gradient)

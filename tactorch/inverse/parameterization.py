"""Parameterisations: the variables of the optimization that stand for Young's moduli."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from tactorch.config import Options, Registry, option
from tactorch.errors import ConfigError


@dataclass(frozen=True)
class Bounds(Options):
    """Limits of Young's modulus, MPa; the paper's by default.

    Attributes:
        lower: Lower limit, MPa; the default is that of a hole.
        upper: Upper limit, MPa.
    """

    section: ClassVar[str] = "bounds"
    lower: float = option(0.001, "Lower limit of Young's modulus", unit="MPa", gt=0)
    upper: float = option(100.0, "Upper limit of Young's modulus", unit="MPa", gt=0)

    def __post_init__(self) -> None:
        """Check the order.

        Raises:
            ConfigError: a limit is not positive, or they are not in order.
        """
        super().__post_init__()
        if not self.lower < self.upper:
            raise ConfigError(
                f"bounds [{self.lower}, {self.upper}] MPa: need 0 < lower < upper; use 0.001 for "
                "the modulus of a hole."
            )


@dataclass(frozen=True)
class Parameterization(Options, ABC):
    """Relation, element by element, between a parameter x and Young's modulus (MPa).

    Attributes:
        bounds: Limits of the modulus; an inversion sets those of its settings.
    """

    section: ClassVar[str] = "parameterization"
    bounds: Bounds = Bounds()

    @abstractmethod
    def youngs(self, x: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Return the moduli of parameters, MPa."""

    @abstractmethod
    def slope(self, x: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Return d youngs / d x, MPa."""

    @abstractmethod
    def second_derivative(self, x: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Return d^2 youngs / d x^2, MPa."""

    def expected_variance_reduction(
        self,
        mean: Float[np.ndarray, " m"],
        before: Float[np.ndarray, " m"],
        after: Float[np.ndarray, " m"],
    ) -> Float[np.ndarray, " m"]:
        """Return the expected reduction of the variance of the moduli, MPa^2, to first order.

        Args:
            mean: Means of the parameters, which are normally distributed.
            before: Their variances.
            after: Their variances given more data, which changes the means too.
        """
        return self.slope(mean) ** 2 * (before - after)

    @abstractmethod
    def parameters(self, youngs: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Return the parameters of moduli."""

    @property
    def max_step(self) -> float:
        """Largest change of a parameter in one damped Newton step."""
        return np.inf

    @property
    def limits(self) -> tuple[float, float]:
        """The bounds, as parameters."""
        low, high = self.parameters(np.array([self.bounds.lower, self.bounds.upper]))
        return float(low), float(high)


class Identity(Parameterization):
    """Young's modulus itself, MPa."""

    def youngs(self, x: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Return the moduli of parameters, MPa."""
        return x

    def slope(self, x: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Return d youngs / d x, MPa."""
        return np.ones_like(x)

    def second_derivative(self, x: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Return zeros."""
        return np.zeros_like(x)

    def parameters(self, youngs: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Return the parameters of moduli."""
        return np.asarray(youngs, dtype=np.float64)


class Scaled(Parameterization):
    """The paper's linear scaling: E = lower + x (upper - lower)."""

    @property
    def _range(self) -> float:
        return self.bounds.upper - self.bounds.lower

    def youngs(self, x: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Return the moduli of parameters, MPa."""
        return np.maximum(self.bounds.lower + self._range * x, self.bounds.lower)

    def slope(self, x: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Return d youngs / d x, MPa."""
        return np.full_like(x, self._range)

    def second_derivative(self, x: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Return zeros."""
        return np.zeros_like(x)

    def parameters(self, youngs: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Return the parameters of moduli."""
        return (youngs - self.bounds.lower) / self._range


class Log(Parameterization):
    """Logarithm: E = exp(x), so that relative changes count and E is positive."""

    @property
    def max_step(self) -> float:
        """A factor of e^2 per step: beyond it the linearisation is meaningless."""
        return 2.0

    def youngs(self, x: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Return the moduli of parameters, MPa."""
        return np.exp(x)

    def slope(self, x: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Return d youngs / d x, MPa."""
        return np.exp(x)

    def second_derivative(self, x: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Return d^2 youngs / d x^2, MPa."""
        return np.exp(x)

    def expected_variance_reduction(
        self,
        mean: Float[np.ndarray, " m"],
        before: Float[np.ndarray, " m"],
        after: Float[np.ndarray, " m"],
    ) -> Float[np.ndarray, " m"]:
        """See `Parameterization.expected_variance_reduction`; exact for a log-normal.

        The new mean is m + N(0, v - v'), so E[e^(2 m' + v') (e^v' - 1)] is
        e^(2 m + 2 v) (1 - e^-v'). Variances are limited to that of a uniform distribution over the
        bounds.
        """
        low, high = self.limits
        share = np.minimum(1.0, (high - low) ** 2 / 12.0 / np.maximum(before, 1e-300))
        v, w = share * before, share * after
        return np.exp(2.0 * (mean + v)) * (np.exp(-w) - np.exp(-v))

    def parameters(self, youngs: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Return the parameters of moduli."""
        return np.log(youngs)


_HERE = "tactorch.inverse.parameterization"
#: Settings of the parameterisations by name.
PARAMETERIZATIONS = Registry(
    "parameterization",
    {"log": f"{_HERE}:Log", "scaled": f"{_HERE}:Scaled", "identity": f"{_HERE}:Identity"},
    "parameters of the map",
)

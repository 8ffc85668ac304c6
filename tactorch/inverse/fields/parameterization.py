"""Parameterisations: the relation between the variables of the optimization and Young's moduli."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from tactorch.config import Options, Registry, option
from tactorch.errors import ConfigError

_Field = Float[np.ndarray, " m"]


@dataclass(frozen=True)
class Bounds(Options):
    """Limits of Young's modulus, MPa; the paper's by default, with that of a hole below."""

    section: ClassVar[str] = "bounds"
    lower: float = option(0.001, "Lower limit of Young's modulus", unit="MPa", gt=0)
    upper: float = option(100.0, "Upper limit of Young's modulus", unit="MPa", gt=0)

    def __post_init__(self) -> None:
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
        max_step: Largest change of a parameter in one damped Newton step.
    """

    section: ClassVar[str] = "parameterization"
    max_step: ClassVar[float] = np.inf
    bounds: Bounds = Bounds()

    @abstractmethod
    def youngs(self, x: _Field) -> _Field:
        """Return the moduli of parameters, MPa."""

    @abstractmethod
    def parameters(self, youngs: _Field) -> _Field:
        """Return the parameters of moduli."""

    @abstractmethod
    def slope(self, x: _Field) -> _Field:
        """Return d youngs / d x, MPa."""

    @abstractmethod
    def second_derivative(self, x: _Field) -> _Field:
        """Return d^2 youngs / d x^2, MPa."""

    def expected_variance_reduction(self, mean: _Field, before: _Field, after: _Field) -> _Field:
        """Return the expected reduction of the variance of the moduli, MPa^2, to first order.

        Args:
            mean: Means of the parameters, which are normally distributed.
            before: Their variances.
            after: Their variances given more data, which changes the means too.
        """
        return self.slope(mean) ** 2 * (before - after)

    @property
    def limits(self) -> tuple[float, float]:
        """The bounds, as parameters."""
        low, high = self.parameters(np.array([self.bounds.lower, self.bounds.upper]))
        return float(low), float(high)


class Scaled(Parameterization):
    """The paper's linear scaling: E = lower + x (upper - lower)."""

    @property
    def _line(self) -> tuple[float, float]:
        """Modulus at zero and slope, MPa."""
        return self.bounds.lower, self.bounds.upper - self.bounds.lower

    def youngs(self, x: _Field) -> _Field:
        origin, slope = self._line
        return np.maximum(origin + slope * x, origin)

    def parameters(self, youngs: _Field) -> _Field:
        origin, slope = self._line
        return (youngs - origin) / slope

    def slope(self, x: _Field) -> _Field:
        return np.full_like(x, self._line[1])

    def second_derivative(self, x: _Field) -> _Field:
        return np.zeros_like(x)


class Identity(Scaled):
    """Young's modulus itself, MPa."""

    @property
    def _line(self) -> tuple[float, float]:
        return 0.0, 1.0

    def youngs(self, x: _Field) -> _Field:
        return x


class Log(Parameterization):
    """Logarithm: E = exp(x), so that relative changes count and E is positive."""

    max_step = 2.0  # a factor of e^2, beyond which the linearisation is meaningless

    def youngs(self, x: _Field) -> _Field:
        return np.exp(x)

    slope = second_derivative = youngs

    def parameters(self, youngs: _Field) -> _Field:
        return np.log(youngs)

    def expected_variance_reduction(self, mean: _Field, before: _Field, after: _Field) -> _Field:
        """See `Parameterization.expected_variance_reduction`; exact for a log-normal.

        The new mean is m + N(0, v - v'), so E[e^(2 m' + v') (e^v' - 1)] is e^(2 m + 2 v) (1 -
        e^-v'). Variances are limited to that of a uniform distribution over the bounds.
        """
        low, high = self.limits
        share = np.minimum(1.0, (high - low) ** 2 / 12.0 / np.maximum(before, 1e-300))
        v, w = share * before, share * after
        return np.exp(2.0 * (mean + v)) * (np.exp(-w) - np.exp(-v))


_HERE = "tactorch.inverse.fields.parameterization"
#: Settings of the parameterisations by name.
PARAMETERIZATIONS = Registry(
    "parameterization",
    {"log": f"{_HERE}:Log", "scaled": f"{_HERE}:Scaled", "identity": f"{_HERE}:Identity"},
)

"""Which constitutive law a recording is to be read with."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from numbers import Real

from tactorch.errors import RecordingError


@dataclass(frozen=True)
class MaterialSpec:
    """A material by name, with everything but Young's modulus.

    Attributes:
        name: Name of the law, such as `neo_hookean`.
        poisson: Poisson's ratio, in (-1, 0.5).
        parameters: Further numbers of the law, such as `{"lame_factor": 0.5}` (dimensionless or
            in mm, N, MPa).

    Raises:
        RecordingError: A value that no elastic solid has.
    """

    name: str
    poisson: float
    parameters: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the values and store them as floats."""
        if not self.name:
            raise RecordingError("material name is empty; give a law such as 'neo_hookean'")
        object.__setattr__(self, "poisson", _number("poisson", self.poisson))
        if not -1.0 < self.poisson < 0.5:
            raise RecordingError(
                f"material poisson is {self.poisson:g}; it must lie in (-1, 0.5). "
                "For an incompressible material use 0.49 to 0.499"
            )
        object.__setattr__(self, "parameters", _parameters(self.parameters))


def _parameters(values: Mapping[str, float]) -> dict[str, float]:
    return {str(key): _number(str(key), value) for key, value in values.items()}


def _number(name: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, Real) or not math.isfinite(value):
        raise RecordingError(f"material {name} is {value!r}; give a finite number")
    return float(value)

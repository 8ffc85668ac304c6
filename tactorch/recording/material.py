"""Constitutive law of a recording."""

import math
from dataclasses import dataclass, field
from numbers import Real

from tactorch.errors import RecordingError


@dataclass(frozen=True)
class MaterialSpec:
    """A material by name, without Young's modulus.

    Attributes:
        name: Name of the law, such as `neo_hookean`.
        poisson: Poisson's ratio, in (-1, 0.5).
        parameters: Further numbers of the law, such as `{"lame_factor": 0.5}` (dimensionless or
            in mm, N, MPa).
    """

    name: str
    poisson: float
    parameters: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.name:
            raise RecordingError("material name is empty; give a law such as 'neo_hookean'")
        object.__setattr__(self, "poisson", _number("poisson", self.poisson))
        if not -1.0 < self.poisson < 0.5:
            raise RecordingError(
                f"material poisson is {self.poisson:g}; it must lie in (-1, 0.5). "
                "For an incompressible material use 0.49 to 0.499"
            )
        parameters = {str(key): _number(str(key), value) for key, value in self.parameters.items()}
        object.__setattr__(self, "parameters", parameters)


def _number(name: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, Real) or not math.isfinite(value):
        raise RecordingError(f"material {name} is {value!r}; give a finite number")
    return float(value)

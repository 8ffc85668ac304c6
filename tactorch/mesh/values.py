"""Validated numbers and vectors of shapes and generators, and types of their arrays."""

from collections.abc import Callable, Sequence
from dataclasses import MISSING, field, fields
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from tactorch.errors import ConfigError

#: Rows of numbers, in any container (numpy's own `ArrayLike` defeats runtime checkers).
Rows = np.ndarray | Sequence[Any]
#: Three numbers, likewise.
Vector = np.ndarray | Sequence[Any]
Real = float | int | np.floating | np.integer
Points = Float[np.ndarray, "n 3"]
Triangles = Int[np.ndarray, "k 3"]
Tets = Int[np.ndarray, "m 4"]
Corners = Float[np.ndarray, "2 3"]


def vector(name: str, value: Vector) -> tuple[float, float, float]:
    """Return three finite numbers as a tuple, or raise `ConfigError` naming the field."""
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{name}={value!r} must be three numbers.") from error
    if array.shape != (3,) or not np.isfinite(array).all():
        raise ConfigError(f"{name}={value!r} must be three finite numbers.")
    return (float(array[0]), float(array[1]), float(array[2]))


def sizes(name: str, value: Vector | Real) -> tuple[float, float, float]:
    """Return three positive numbers; a single number is repeated."""
    three = vector(name, value if isinstance(value, np.ndarray | Sequence) else [value] * 3)
    if min(three) <= 0:
        raise ConfigError(f"{name}={value!r} must be positive.")
    return three


def positive(name: str, value: Real) -> float:
    """Return a positive finite number, or raise `ConfigError` naming the field."""
    if not (np.isfinite(value) and value > 0):
        raise ConfigError(f"{name}={value!r} must be a positive number.")
    return float(value)


def unit_vector(name: str, value: Vector) -> tuple[float, float, float]:
    """Return the vector scaled to length 1, or raise `ConfigError` if it has no direction."""
    array = np.array(vector(name, value))
    length = float(np.linalg.norm(array))
    if length < 1e-12:
        raise ConfigError(f"{name}={value!r} has no direction; give a non-zero vector.")
    # A unit vector is not scaled again, so that stored shapes are read back as they were.
    return vector(name, array if abs(length - 1.0) < 1e-14 else array / length)


def checked(check: Callable[[str, Any], Any], default: Any = MISSING) -> Any:
    """Declare a field of a `Checked` dataclass, converted by `check(name, value)`."""
    return field(default=default, metadata={"check": check})


class Checked:
    """Base of frozen dataclasses whose `checked` fields are validated on construction."""

    def __post_init__(self) -> None:
        """Convert every checked field; a `ConfigError` names the field."""
        for declared in fields(self):  # type: ignore[arg-type]
            if check := declared.metadata.get("check"):
                value = check(declared.name, getattr(self, declared.name))
                object.__setattr__(self, declared.name, value)

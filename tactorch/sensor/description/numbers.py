"""Checked numbers of a sensor's description."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from tactorch.errors import ConfigError
from tactorch.mesh.values import positive


def numbers(name: str, value: Sequence[Any] | Any, count: int) -> tuple[float, ...]:
    """Return so many finite numbers, or raise `ConfigError` naming the field."""
    try:
        array = np.asarray(list(value), dtype=float)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{name}={value!r} must be {count} numbers.") from error
    if array.shape != (count,) or not np.isfinite(array).all():
        raise ConfigError(f"{name}={value!r} must be {count} finite numbers.")
    return tuple(float(number) for number in array)


def lengths(name: str, value: Sequence[Any] | Any, count: int) -> tuple[float, ...]:
    """Return so many positive numbers, or raise `ConfigError` naming the field."""
    return tuple(positive(f"{name}[{i}]", one) for i, one in enumerate(numbers(name, value, count)))


def pixels(name: str, value: Sequence[Any] | Any, least: int = 8) -> tuple[int, int]:
    """Return width and height in whole pixels, or raise `ConfigError` naming the field."""
    width, height = numbers(name, value, 2)
    if min(width, height) < least or width % 1 or height % 1:
        raise ConfigError(
            f"{name}={list(value)}: give width and height as whole pixels, from {least}."
        )
    return int(width), int(height)

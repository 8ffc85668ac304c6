"""Checked numbers of a sensor's description."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from tactorch.errors import ConfigError
from tactorch.mesh.values import positive

_MOST_PX = 20000
_LEAST_MM, _MOST_MM = 1e-4, 1.0  # of a pixel


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
    if min(width, height) < least or max(width, height) > _MOST_PX or width % 1 or height % 1:
        raise ConfigError(
            f"{name}={list(value)}: give width and height as whole pixels, from {least} to"
            f" {_MOST_PX}."
        )
    return int(width), int(height)


def pixel_size(name: str, value: Sequence[Any] | Any) -> tuple[float, float]:
    """Return the size of a pixel along x and y in mm, or raise `ConfigError` naming the field."""
    x, y = lengths(name, value, 2)
    for number in (x, y):
        if number > _MOST_MM:
            raise ConfigError(
                f"{name}={[x, y]}: a pixel of {number:g} mm looks like pixels per mm; give mm per"
                f" pixel ({1 / number:.4g})."
            )
        if number < _LEAST_MM:
            raise ConfigError(
                f"{name}={[x, y]}: a pixel of {number:g} mm looks like metres; give mm per pixel"
                f" ({1e3 * number:.4g})."
            )
    return x, y


def plausible(name: str, value: float, least: float, most: float) -> float:
    """Return a length between bounds in mm, or raise `ConfigError` naming the field."""
    number = positive(name, value)
    if not least <= number <= most:
        metres = f" Is it in metres? Then give {1e3 * number:g}."
        raise ConfigError(
            f"{name}={number:g}: give mm, from {least:g} to {most:g}."
            + (metres if least <= 1e3 * number <= most else "")
        )
    return number

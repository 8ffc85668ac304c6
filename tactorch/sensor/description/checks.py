"""Checks of the numbers in a sensor description; a failed check raises `ConfigError`."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from tactorch.errors import ConfigError
from tactorch.mesh.values import positive

_MAX_IMAGE_PX = 20000
_MIN_PIXEL_MM, _MAX_PIXEL_MM = 1e-4, 1.0


def finite_numbers(name: str, value: Sequence[Any] | Any, count: int) -> tuple[float, ...]:
    """Return `count` finite numbers."""
    try:
        array = np.asarray(list(value), dtype=float)
    except (TypeError, ValueError, OverflowError) as error:
        raise ConfigError(f"{name}={value!r} must be {count} numbers.") from error
    if array.shape != (count,) or not np.isfinite(array).all():
        raise ConfigError(f"{name}={value!r} must be {count} finite numbers.")
    return tuple(float(number) for number in array)


def positive_lengths(name: str, value: Sequence[Any] | Any, count: int) -> tuple[float, ...]:
    """Return `count` positive numbers."""
    numbers = finite_numbers(name, value, count)
    return tuple(positive(f"{name}[{i}]", number) for i, number in enumerate(numbers))


def image_size(name: str, value: Sequence[Any] | Any, min_px: int = 8) -> tuple[int, int]:
    """Return width and height in whole pixels."""
    width, height = finite_numbers(name, value, 2)
    too_large = max(width, height) > _MAX_IMAGE_PX
    if min(width, height) < min_px or too_large or width % 1 or height % 1:
        raise ConfigError(
            f"{name}={list(value)}: give width and height as whole pixels, from {min_px} to"
            f" {_MAX_IMAGE_PX}."
        )
    return int(width), int(height)


def pixel_size(name: str, value: Sequence[Any] | Any) -> tuple[float, float]:
    """Return the size of a pixel along x and y, mm."""
    x, y = positive_lengths(name, value, 2)
    for number in (x, y):
        if number > _MAX_PIXEL_MM:
            raise ConfigError(
                f"{name}={[x, y]}: a pixel of {number:g} mm looks like pixels per mm; give mm per"
                f" pixel ({1 / number:.4g})."
            )
        if number < _MIN_PIXEL_MM:
            raise ConfigError(
                f"{name}={[x, y]}: a pixel of {number:g} mm looks like metres; give mm per pixel"
                f" ({1e3 * number:.4g})."
            )
    return x, y


def length_in_range(name: str, value: float, min_mm: float, max_mm: float) -> float:
    """Return a length within bounds, mm."""
    number = positive(name, value)
    if not min_mm <= number <= max_mm:
        metres = f" Is it in metres? Then give {1e3 * number:g}."
        raise ConfigError(
            f"{name}={number:g}: give mm, from {min_mm:g} to {max_mm:g}."
            + (metres if min_mm <= 1e3 * number <= max_mm else "")
        )
    return number

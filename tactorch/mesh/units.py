"""Lengths in files: converted to mm once, here, and doubted when they look wrong."""

import warnings

from tactorch.errors import ConfigError

MM_PER_UNIT = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
#: Bounding-box diagonals between which an object pressed by hand or robot is plausible, mm.
PLAUSIBLE_MM = (0.5, 5000.0)


def mm_per(unit: str) -> float:
    """Return the length of `unit` in mm.

    Raises:
        ConfigError: The unit is unknown.
    """
    if unit not in MM_PER_UNIT:
        raise ConfigError(f"Unknown length unit '{unit}'; choose one of {', '.join(MM_PER_UNIT)}.")
    return MM_PER_UNIT[unit]


def warn_of_units(what: str, diagonal_mm: float, unit: str) -> None:
    """Warn, naming the likely unit, where an object is implausibly small or large."""
    low, high = PLAUSIBLE_MM
    if low <= diagonal_mm <= high:
        return
    number = diagonal_mm / MM_PER_UNIT[unit]
    likely = [u for u, mm in MM_PER_UNIT.items() if low <= number * mm <= high]
    hint = " or ".join(f"unit='{u}' ({number * MM_PER_UNIT[u]:.4g} mm)" for u in likely)
    advice = f"Is it {hint}?" if hint else "Check the unit and scale of the file."
    warnings.warn(
        f"{what} is {diagonal_mm:.4g} mm across when read in {unit}: implausible. {advice}",
        UserWarning,
        stacklevel=3,
    )

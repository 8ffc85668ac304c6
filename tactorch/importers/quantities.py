"""Names and units of the columns of tables; docs/howto/formats.md has those of a table of presses.

A unit is a suffix of the name, such as ux_m or "p [kPa]", or stated by `format.units`; without one
quantities are in mm, mm2, N, MPa and N/mm.
"""

import re
import unicodedata
from collections.abc import Mapping

from tactorch.errors import ConfigError

_AXES = "xyz"
LENGTHS = {"mm": 1.0, "cm": 10.0, "m": 1e3, "um": 1e-3, "in": 25.4, "inch": 25.4}
_AREAS = {"mm2": 1.0, "cm2": 100.0, "m2": 1e6}
_GRAM = 9.80665e-3  # weight, N
FORCES = {
    **{"n": 1.0, "mn": 1e-3, "kn": 1e3, "g": _GRAM, "gf": _GRAM},
    **{"kg": 1e3 * _GRAM, "kgf": 1e3 * _GRAM, "lbf": 453.59237 * _GRAM},
}
_STRESSES = {"mpa": 1.0, "kpa": 1e-3, "pa": 1e-6}
_STIFFNESSES = {"n_per_mm": 1.0, "n_per_m": 1e-3}
_NONE: dict[str, float] = {}
#: Units of each quantity: factor to mm, N and MPa by suffix.
UNITS: dict[str, dict[str, float]] = {
    "press": _NONE,
    "step": _NONE,
    "node": _NONE,
    **{axis: LENGTHS for axis in _AXES},
    **{f"u{axis}": LENGTHS for axis in _AXES},
    "u_n": LENGTHS,
    **{f"n{axis}": _NONE for axis in _AXES},
    **{f"f{axis}": FORCES for axis in _AXES},
    **{f"t{axis}": _STRESSES for axis in _AXES},
    "p": _STRESSES,
    "area": _AREAS,
    "noise": LENGTHS,
    **{f"fixed_{axis}": _NONE for axis in _AXES},
    **{f"spring_{axis}": _STIFFNESSES for axis in _AXES},
}
#: The same of a palpation.
PALPATION_UNITS: dict[str, dict[str, float]] = {
    "probe": _NONE,
    **{axis: LENGTHS for axis in _AXES},
    **{f"f{axis}": FORCES for axis in _AXES},
    **{f"contact_{axis}": LENGTHS for axis in _AXES},
    **{f"normal_{axis}": _NONE for axis in _AXES},
}
#: Suffixes that state a unit.
SUFFIXES = {unit for units in UNITS.values() for unit in units} | {"s", "ms", "us", "ns"}
# Units that are not read, but may end the name of a column.
_OTHERS = {"ft", "mil", "nm", "dyn", "lb", "oz", "ozf", "kp", "psi", "bar"}
_BRACKET = re.compile(r"(.*?)\s*[\[(]([^\])]*)[\])]")


def vector(letter: str) -> tuple[str, str, str]:
    """Return the names of the three components of a quantity, such as "u" or "fixed_"."""
    return f"{letter}x", f"{letter}y", f"{letter}z"


def assign(
    names: list[str],
    columns: Mapping[str, str],
    units: Mapping[str, str],
    known: Mapping[str, Mapping[str, float]] = UNITS,
) -> dict[str, tuple[str, float]]:
    """Return the column and the factor of each quantity that a table has.

    `columns` has the column of a quantity, where its name is another, `units` its unit, where the
    name does not state it; `known` are the units of each quantity that a table may have.

    Raises:
        ConfigError: A quantity or unit is unknown, a column is missing, or two columns have the
            same quantity.
    """
    for what, given in (("columns", columns), ("units", units)):
        unknown = [quantity for quantity in given if quantity not in known]
        if unknown:
            raise ConfigError(
                f"format.{what}: the quantity {unknown[0]!r} is unknown; choose of "
                f"{', '.join(known)}."
            )
    found: dict[str, tuple[str, float]] = {}
    short = {_BRACKET.sub(r"\1", name): name for name in names}
    columns = {q: n if n in names else short.get(n, n) for q, n in columns.items()}
    for quantity, column in columns.items():
        if column not in names:
            raise ConfigError(
                f"format.columns: there is no column {column!r} for {quantity}; the columns are "
                f"{', '.join(names)}."
            )
        found[quantity] = (column, _suffix(quantity, column, known[quantity], units))
    taken, meanings = set(columns.values()), _meanings(known)
    for name in names:
        match = None if name in taken else meanings.get(clean(name))
        if match is None or match[0] in columns:
            continue
        if match[0] in found:
            raise ConfigError(
                f"The columns {found[match[0]][0]!r} and {name!r} both have {match[0]}; remove "
                "one, or choose by format.columns."
            )
        found[match[0]] = (name, match[1])
    for name in names:
        quantity, unit = _parts(name)
        if unit and quantity in known and quantity not in found:
            found[quantity] = (name, _suffix(quantity, name, known[quantity], units))
    return found | {
        quantity: (found[quantity][0], _factor(quantity, unit, known[quantity]))
        for quantity, unit in units.items()
        if quantity in found
    }


def parse(name: str) -> tuple[str, float] | None:
    """Return the quantity and the factor of its unit that a name of a column states."""
    return _meanings(UNITS).get(clean(name))


def clean(name: str) -> str:
    """Return a name in lower case, with underscores for spaces and brackets: x_mm for "X [mm]"."""
    plain = unicodedata.normalize("NFKC", name).replace("μ", "u")  # both letters for micro
    return re.sub(r"\W+", "_", plain.lower()).strip("_")


def _meanings(known: Mapping[str, Mapping[str, float]]) -> dict[str, tuple[str, float]]:
    return {
        f"{quantity}_{unit}" if unit else quantity: (quantity, factor)
        for quantity, units in known.items()
        for unit, factor in {"": 1.0, **units}.items()
    }


def _parts(name: str) -> tuple[str, str]:
    """Return the name of a column without its unit, and a unit in brackets or of `_OTHERS`."""
    if bracket := _BRACKET.fullmatch(name):
        return clean(bracket[1]), bracket[2]
    stem, _, unit = clean(name).rpartition("_")
    return (stem, unit) if unit in _OTHERS else (clean(name), "")


def _suffix(
    quantity: str, column: str, units: Mapping[str, float], stated: Mapping[str, str]
) -> float:
    """Return the factor of the unit at the end of a name; 1 where there is none, or one is stated.

    Quantities without units may have anything there, such as "Probe [-]".
    """
    matches = [unit for unit in units if clean(column).endswith(f"_{unit}")]
    unit = _parts(column)[1]
    if units and unit and not matches and quantity not in stated:
        raise ConfigError(
            f"The column {column!r} has the unit {unit!r}, which is none of {', '.join(units)}; "
            "convert its numbers, and state their unit, as in "
            f'"format.units={{{quantity}: {next(iter(units))}}}", or remove the column.'
        )
    return units[max(matches, key=len)] if matches else 1.0


def _factor(quantity: str, unit: str, units: Mapping[str, float]) -> float:
    key = unit.lower().replace("/", "_per_")
    if key not in units:
        known = ", ".join(units) or "none"
        raise ConfigError(f"format.units: {quantity} has no unit {unit!r}; its units are {known}.")
    return units[key]

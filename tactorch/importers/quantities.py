"""Names and units of the columns of a table of presses; docs/howto/formats.md has the table.

A unit is a suffix of the name, such as ux_m or p_kpa, or stated by `format.units`; without one
quantities are in mm, mm2, N, MPa and N/mm.
"""

from collections.abc import Mapping

from tactorch.errors import ConfigError

_AXES = "xyz"
_LENGTHS = {"mm": 1.0, "cm": 10.0, "m": 1e3, "um": 1e-3}
_AREAS = {"mm2": 1.0, "cm2": 100.0, "m2": 1e6}
_FORCES = {"n": 1.0, "mn": 1e-3, "kn": 1e3}
_STRESSES = {"mpa": 1.0, "kpa": 1e-3, "pa": 1e-6}
_STIFFNESSES = {"n_per_mm": 1.0, "n_per_m": 1e-3}
_NONE: dict[str, float] = {}
#: Units of each quantity: factor to mm, N and MPa by suffix.
UNITS: dict[str, dict[str, float]] = {
    "press": _NONE,
    "step": _NONE,
    "node": _NONE,
    **{axis: _LENGTHS for axis in _AXES},
    **{f"u{axis}": _LENGTHS for axis in _AXES},
    "u_n": _LENGTHS,
    **{f"n{axis}": _NONE for axis in _AXES},
    **{f"f{axis}": _FORCES for axis in _AXES},
    **{f"t{axis}": _STRESSES for axis in _AXES},
    "p": _STRESSES,
    "area": _AREAS,
    "noise": _LENGTHS,
    **{f"fixed_{axis}": _NONE for axis in _AXES},
    **{f"spring_{axis}": _STIFFNESSES for axis in _AXES},
}
_COLUMNS = {
    f"{quantity}_{unit}" if unit else quantity: (quantity, factor)
    for quantity, units in UNITS.items()
    for unit, factor in {"": 1.0, **units}.items()
}


def vector(letter: str) -> tuple[str, str, str]:
    """Return the names of the three components of a quantity, such as "u" or "fixed_"."""
    return f"{letter}x", f"{letter}y", f"{letter}z"


def assign(
    names: list[str], columns: Mapping[str, str], units: Mapping[str, str]
) -> dict[str, tuple[str, float]]:
    """Return the column and the factor of each quantity that a table has.

    Args:
        names: Names of the columns.
        columns: Column of a quantity, where its name is another.
        units: Unit of a quantity, where its name does not state it.

    Raises:
        ConfigError: A quantity or unit is unknown, a column is missing, or two columns have the
            same quantity.
    """
    for what, given in (("columns", columns), ("units", units)):
        unknown = [quantity for quantity in given if quantity not in UNITS]
        if unknown:
            raise ConfigError(
                f"format.{what}: the quantity {unknown[0]!r} is unknown; choose of "
                f"{', '.join(UNITS)}."
            )
    found: dict[str, tuple[str, float]] = {}
    for quantity, column in columns.items():
        if column not in names:
            raise ConfigError(
                f"format.columns: there is no column {column!r} for {quantity}; the columns are "
                f"{', '.join(names)}."
            )
        found[quantity] = (column, _suffix(column.lower(), quantity))
    taken = set(columns.values())
    for name in names:
        match = None if name in taken else parse(name)
        if match is None or match[0] in columns:
            continue
        if match[0] in found:
            raise ConfigError(
                f"The columns {found[match[0]][0]!r} and {name!r} both have {match[0]}; remove "
                "one, or choose by format.columns."
            )
        found[match[0]] = (name, match[1])
    return found | {
        quantity: (found[quantity][0], _factor(quantity, unit))
        for quantity, unit in units.items()
        if quantity in found
    }


def parse(name: str) -> tuple[str, float] | None:
    """Return the quantity and the factor of its unit that a name of a column states."""
    return _COLUMNS.get(name.strip().lower())


def _suffix(text: str, quantity: str) -> float:
    """Return the factor of the unit at the end of a name; 1 where there is none."""
    matches = [unit for unit in UNITS[quantity] if text.endswith(f"_{unit}")]
    return UNITS[quantity][max(matches, key=len)] if matches else 1.0


def _factor(quantity: str, unit: str) -> float:
    key = unit.lower().replace("/", "_per_")
    if key not in UNITS[quantity]:
        known = ", ".join(UNITS[quantity]) or "none"
        raise ConfigError(f"format.units: {quantity} has no unit {unit!r}; its units are {known}.")
    return UNITS[quantity][key]

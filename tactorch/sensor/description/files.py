"""Descriptions of sensors in YAML files, and those that come with tactorch."""

from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any, TypeVar

import yaml

from tactorch.errors import ConfigError, FileError
from tactorch.files import atomic_path, require_file
from tactorch.plain import plain_fields
from tactorch.sensor.description.gel_layer import GelLayer
from tactorch.sensor.description.marker_grid import MarkerGrid
from tactorch.sensor.description.sensor import SensorDescription

_T = TypeVar("_T", GelLayer, MarkerGrid, SensorDescription)
_TEXTS = ("name", "material")  # all other fields are numbers
_SHIPPED = Path(__file__).parent
#: Names of the sensors that come with tactorch.
SENSORS = tuple(sorted(path.stem for path in _SHIPPED.glob("*.yaml")))


def load_sensor(name: str | Path) -> SensorDescription:
    """Read a description.

    Args:
        name: Path of a `sensor.yaml`, or one of `SENSORS`.

    Raises:
        FileError: The file is missing or no YAML.
        ConfigError: A field is missing, unknown or has a value that cannot be used.
    """
    if str(name) in SENSORS:
        path = _SHIPPED / f"{name}.yaml"
    else:
        path = require_file(name, f"sensor description (or one of {', '.join(SENSORS)})")
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        where = " ".join(str(error).split())
        raise FileError(f"sensor description '{path}' is no YAML: {where}.") from error
    if not isinstance(content, dict):
        raise FileError(f"sensor description '{path}' holds no fields; see the shipped ones.")
    try:
        return _described(content)
    except ConfigError as error:
        raise ConfigError(f"sensor description '{path}': {error}") from error


def save_sensor(sensor: SensorDescription, path: str | Path) -> None:
    """Write a description.

    Raises:
        FileError: The file cannot be written.
    """
    with atomic_path(path) as temporary:
        text = yaml.safe_dump(plain_fields(sensor), sort_keys=False, default_flow_style=None)
        temporary.write_text(text, encoding="utf-8")


def _described(content: dict[str, Any]) -> SensorDescription:
    parts: dict[str, Any] = {"gel": _made("gel", GelLayer, content.get("gel"))}
    if content.get("markers") is not None:
        parts["markers"] = _made("markers", MarkerGrid, content["markers"])
    return _made("", SensorDescription, {**content, **parts})


def _made(what: str, make: type[_T], settings: Any) -> _T:
    """Make a part of a description; complaints then name the part."""
    if not isinstance(settings, dict):
        raise ConfigError(f"{what} is missing, or no table of fields.")
    prefix = f"{what}: " if what else ""
    known = {field.name: field for field in fields(make)}
    for name in settings:
        if name not in known:
            raise ConfigError(f"{prefix}there is no field '{name}'; choose of {', '.join(known)}.")
    for name, field in known.items():
        if name not in settings and field.default is MISSING:
            raise ConfigError(f"{prefix}{name} is missing.")
    for name, value in settings.items():
        if isinstance(value, str) != (name in _TEXTS) and value is not None:
            kind = (
                "text; put it in quotes"
                if name in _TEXTS
                else "a number (YAML takes 1.0e-3 for one, not 1e-3)"
            )
            raise ConfigError(f"{prefix}{name}={value!r} must be {kind}.")
    try:
        return make(**settings)
    except ConfigError as error:
        raise ConfigError(f"{prefix}{error}") from error
    except (TypeError, ValueError) as error:  # a word for a number, or a number for a list
        raise ConfigError(
            f"{prefix}a field is of another kind than it should be: {error}."
        ) from error

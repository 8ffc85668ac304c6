"""YAML files of sensor descriptions, including those shipped with tactorch."""

from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any, TypeVar

import yaml

from tactorch.errors import ConfigError, FileError
from tactorch.files import atomic_path, require_file
from tactorch.plain import plain_fields
from tactorch.sensor.description.sensor import GelLayer, MarkerGrid, SensorDescription

_T = TypeVar("_T", GelLayer, MarkerGrid, SensorDescription)
_TEXT_FIELDS = ("name", "material")  # all other fields are numbers
_COUNT_FIELDS = ("columns", "rows", "image_size_px", "raw_size_px", "warped_size_px", "crop_px")
_SHIPPED = Path(__file__).parent
_MAX_BYTES, _MAX_DEPTH = 1_000_000, 10
#: Names of the descriptions shipped with tactorch.
SENSORS = tuple(sorted(path.stem for path in _SHIPPED.glob("*.yaml")))


def load_sensor(name: str | Path) -> SensorDescription:
    """Read a sensor description.

    Args:
        name: Path of a `sensor.yaml`, or one of `SENSORS`.

    Returns:
        The description.

    Raises:
        FileError: The file is missing or not valid YAML.
        ConfigError: A field is missing, unknown or out of range.
    """
    if str(name) in SENSORS:
        path = _SHIPPED / f"{name}.yaml"
    else:
        path = require_file(name, f"sensor description (or one of {', '.join(SENSORS)})")
    content = _read_yaml(path)
    if not isinstance(content, dict):
        raise FileError(f"sensor description '{path}' has no fields; see the shipped ones.")
    try:
        parts: dict[str, Any] = {"gel": _build("gel", GelLayer, content.get("gel"))}
        if content.get("markers") is not None:
            parts["markers"] = _build("markers", MarkerGrid, content["markers"])
        return _build("", SensorDescription, {**content, **parts})
    except ConfigError as error:
        raise ConfigError(f"sensor description '{path}': {error}") from error


def save_sensor(sensor: SensorDescription, path: str | Path) -> None:
    """Write a sensor description.

    Raises:
        FileError: The file cannot be written.
    """
    with atomic_path(path) as temporary:
        text = yaml.safe_dump(plain_fields(sensor), sort_keys=False, default_flow_style=None)
        temporary.write_text(text, encoding="utf-8")


def _read_yaml(path: Path) -> Any:
    """Read a small YAML file without aliases or deep nesting, on which the parser recurses."""
    if path.stat().st_size > _MAX_BYTES:
        raise FileError(
            f"sensor description '{path}' has {path.stat().st_size} bytes; give one of up to"
            f" {_MAX_BYTES}."
        )
    try:
        text, depth = path.read_text(encoding="utf-8"), 0
        for event in yaml.parse(text, Loader=yaml.SafeLoader):
            if isinstance(event, yaml.AliasEvent):
                raise FileError(
                    f"sensor description '{path}' uses the alias '*{event.anchor}'; write the"
                    " value in its place."
                )
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            if depth > _MAX_DEPTH:
                raise FileError(
                    f"sensor description '{path}' is nested deeper than {_MAX_DEPTH} levels; see"
                    " the shipped ones."
                )
        return yaml.safe_load(text)
    except (yaml.YAMLError, ValueError) as error:  # also dates and numbers that do not exist
        reason = " ".join(str(error).split())
        raise FileError(f"sensor description '{path}' is not valid YAML: {reason}.") from error


def _build(part: str, cls: type[_T], values: Any) -> _T:
    """Make a part of a description; error messages name the part."""
    if not isinstance(values, dict):
        raise ConfigError(f"{part} is missing, or not a table of fields.")
    prefix = f"{part}: " if part else ""
    known = {field.name: field for field in fields(cls)}
    for name in values:
        if name not in known:
            raise ConfigError(f"{prefix}there is no field '{name}'; choose of {', '.join(known)}.")
    for name, field in known.items():
        if name not in values and field.default is MISSING:
            raise ConfigError(f"{prefix}{name} is missing.")
    values = {name: _check_value(f"{prefix}{name}", name, v) for name, v in values.items()}
    try:
        return cls(**values)
    except ConfigError as error:
        raise ConfigError(f"{prefix}{error}") from error
    except (TypeError, ValueError, OverflowError) as error:  # a list for a number, for example
        raise ConfigError(f"{prefix}a field has a value of the wrong type: {error}.") from error


def _check_value(label: str, name: str, value: Any) -> Any:
    """Return a value of the kind that its field has: text, numbers or whole numbers."""
    if value is None or isinstance(value, GelLayer | MarkerGrid):
        return value
    if isinstance(value, list) and name not in _TEXT_FIELDS:
        return [_check_value(label, name, item) for item in value]
    if name in _TEXT_FIELDS:
        kind = "" if isinstance(value, str) else "text; put it in quotes"
    elif isinstance(value, bool) or not isinstance(value, int | float):
        kind = "a number (YAML takes 1.0e-3 for one, not 1e-3)"
    elif name in _COUNT_FIELDS and value % 1:
        kind = "a whole number"
    else:
        return int(value) if name in _COUNT_FIELDS else value
    if kind:
        raise ConfigError(f"{label}={value!r} must be {kind}.")
    return value

"""Shapes as plain dictionaries, for configuration files and provenance."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

from tactorch.errors import ConfigError
from tactorch.mesh import (
    Box,
    Cone,
    Cylinder,
    Ellipsoid,
    Hemisphere,
    Hyperboloid,
    Lathe,
    Rotated,
    Shape,
    Sphere,
    Torus,
    Union,
)

SHAPES: dict[str, type[Any]] = {
    "box": Box,
    "cone": Cone,
    "cylinder": Cylinder,
    "ellipsoid": Ellipsoid,
    "hemisphere": Hemisphere,
    "hyperboloid": Hyperboloid,
    "lathe": Lathe,
    "rotated": Rotated,
    "sphere": Sphere,
    "torus": Torus,
    "union": Union,
}


def shape_to_config(shape: Shape) -> dict[str, Any]:
    """Return the shape as `{"shape": name, field: number, list or shape, ...}`.

    Raises:
        ConfigError: The shape is none of `SHAPES`.
    """
    for name, kind in SHAPES.items():
        if isinstance(shape, kind):
            values = {field.name: getattr(shape, field.name) for field in fields(kind)}
            return {"shape": name, **{k: _plain(v) for k, v in values.items()}}
    raise ConfigError(
        f"{type(shape).__name__} has no configuration; shapes that have one: {', '.join(SHAPES)}."
    )


def shape_from_config(config: Any, where: str) -> Shape:
    """Make a shape from what `shape_to_config` returns; fields left out take their defaults.

    Args:
        config: The dictionary.
        where: What to call it in messages.

    Raises:
        ConfigError: The name or a field is unknown, or a value cannot be used.
    """
    values = as_mapping(config, where)
    name = values.pop("shape", None)
    if name not in SHAPES:
        raise ConfigError(f"{where}: shape is {name!r}; choose one of {', '.join(SHAPES)}.")
    kind = SHAPES[name]
    refuse_unknown(values, {field.name for field in fields(kind)}, where)
    inner = {key: _inner(value, f"{where}.{key}") for key, value in values.items()}
    try:
        return kind(**inner)
    except TypeError as error:
        raise ConfigError(f"{where}: {name} lacks a field ({error}).") from error
    except ConfigError as error:
        raise ConfigError(f"{where}: {error}") from error


def _plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    return shape_to_config(value) if isinstance(value, Shape) else value


def _inner(value: Any, where: str) -> Any:
    """Make shapes of what describes one, alone or in a list."""
    if isinstance(value, Mapping):
        return shape_from_config(value, where)
    if isinstance(value, Sequence) and any(isinstance(item, Mapping) for item in value):
        return [shape_from_config(item, f"{where}[{i}]") for i, item in enumerate(value)]
    return value


def as_mapping(config: Any, where: str) -> dict[str, Any]:
    """Return a copy as a dictionary, or raise `ConfigError`."""
    if not isinstance(config, Mapping):
        raise ConfigError(f"{where} is {config!r}; give a dictionary.")
    return dict(config)


def refuse_unknown(values: Mapping[str, Any], known: set[str], where: str) -> None:
    """Raise `ConfigError` for keys that mean nothing: a misspelt one would else be lost."""
    unknown = sorted(str(key) for key in values if key not in known)
    if unknown:
        raise ConfigError(
            f"{where}: unknown {', '.join(unknown)}; known are {', '.join(sorted(known))}."
        )

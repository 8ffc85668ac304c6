"""Shapes as plain dictionaries, for configuration files and provenance."""

from collections.abc import Mapping
from dataclasses import asdict, fields
from typing import Any

from tactorch.errors import ConfigError
from tactorch.mesh import Box, Cylinder, Ellipsoid, Shape, Sphere

SHAPES: dict[str, type[Box] | type[Cylinder] | type[Ellipsoid] | type[Sphere]] = {
    "box": Box,
    "cylinder": Cylinder,
    "ellipsoid": Ellipsoid,
    "sphere": Sphere,
}


def shape_to_config(shape: Shape) -> dict[str, Any]:
    """Return the shape as `{"shape": name, field: number or list, ...}`.

    Raises:
        ConfigError: The shape is none of `SHAPES`.
    """
    for name, kind in SHAPES.items():
        if isinstance(shape, kind):
            values = asdict(shape)
            plain = {k: list(v) if isinstance(v, tuple) else v for k, v in values.items()}
            return {"shape": name, **plain}
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
    try:
        return kind(**values)
    except ConfigError as error:
        raise ConfigError(f"{where}: {error}") from error


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

"""Shapes and backgrounds as plain dictionaries, for configuration files and provenance."""

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
    Sphere,
    Torus,
    Union,
)
from tactorch.phantoms.background import Gradient, Layers, RandomField

#: Classes by name, for each key that a dictionary gives the name under.
CLASSES: dict[str, dict[str, type[Any]]] = {
    "shape": {
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
    },
    "field": {"gradient": Gradient, "layers": Layers, "random": RandomField},
}


def to_config(value: Any) -> dict[str, Any]:
    """Return a shape or background as `{"shape": name, field: number, list or shape, ...}`.

    Backgrounds have the key "field" in place of "shape".

    Raises:
        ConfigError: The class is none of `CLASSES`.
    """
    for key, classes in CLASSES.items():
        for name, cls in classes.items():
            if isinstance(value, cls):
                return {key: name, **{f.name: _plain(getattr(value, f.name)) for f in fields(cls)}}
    known = ", ".join(cls.__name__ for classes in CLASSES.values() for cls in classes.values())
    raise ConfigError(f"{type(value).__name__} has no configuration; use one of {known}.")


def from_config(key: str, config: Any, where: str) -> Any:
    """Make a shape or background from what `to_config` returns; other fields have defaults.

    Args:
        key: "shape" or "field".
        config: Dictionary.
        where: Name of the dictionary in messages.

    Raises:
        ConfigError: The name or a field is unknown or missing, or a value is invalid.
    """
    values = as_mapping(config, where)
    name, classes = values.pop(key, None), CLASSES[key]
    if name not in classes:
        raise ConfigError(f"{where}: {key} is {name!r}; choose one of {', '.join(classes)}.")
    refuse_unknown(values, {field.name for field in fields(classes[name])}, where)
    arguments = {k: _nested(key, value, f"{where}.{k}") for k, value in values.items()}
    try:
        return classes[name](**arguments)
    except TypeError as error:
        raise ConfigError(f"{where}: {name} lacks a field ({error}).") from error
    except ConfigError as error:
        raise ConfigError(f"{where}: {error}") from error


def _plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    return to_config(value) if isinstance(value, tuple(CLASSES["shape"].values())) else value


def _nested(key: str, value: Any, where: str) -> Any:
    """Make shapes of dictionaries, alone or in a list."""
    if isinstance(value, Mapping):
        return from_config(key, value, where)
    if isinstance(value, Sequence) and any(isinstance(item, Mapping) for item in value):
        return [from_config(key, item, f"{where}[{i}]") for i, item in enumerate(value)]
    return value


def as_mapping(config: Any, where: str) -> dict[str, Any]:
    """Return a copy as a dictionary, or raise `ConfigError`."""
    if not isinstance(config, Mapping):
        raise ConfigError(f"{where} is {config!r}; give a dictionary.")
    return dict(config)


def refuse_unknown(values: Mapping[str, Any], known: set[str], where: str) -> None:
    """Raise `ConfigError` for unknown keys, such as misspelt ones."""
    unknown = sorted(str(key) for key in values if key not in known)
    if unknown:
        raise ConfigError(
            f"{where}: unknown {', '.join(unknown)}; known are {', '.join(sorted(known))}."
        )

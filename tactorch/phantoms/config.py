"""Shapes and backgrounds as plain dictionaries, for configuration files and provenance."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import fields
from typing import Any

from tactorch import mesh
from tactorch.errors import ConfigError
from tactorch.phantoms.background import Gradient, Layers, RandomField

_SHAPES = (
    mesh.BodyFile, mesh.Box, mesh.Cone, mesh.Cylinder, mesh.Ellipsoid, mesh.Hemisphere,
    mesh.Hyperboloid, mesh.Lathe, mesh.Rotated, mesh.Sphere, mesh.Torus, mesh.Union,
)  # fmt: skip
#: Classes by name, for each key that a dictionary gives the name under.
CLASSES: dict[str, dict[str, type[Any]]] = {
    "shape": {cls.__name__.lower(): cls for cls in _SHAPES},
    "field": {"gradient": Gradient, "layers": Layers, "random": RandomField},
}


def to_config(value: Any) -> dict[str, Any]:
    """Return a shape or background as `{"shape": name, field: number, list or shape, ...}`.

    Backgrounds have the key "field" in place of "shape".
    """
    for key, classes in CLASSES.items():
        for name, cls in classes.items():
            if isinstance(value, cls):
                return {key: name, **{f.name: _plain(getattr(value, f.name)) for f in fields(cls)}}
    known = ", ".join(cls.__name__ for classes in CLASSES.values() for cls in classes.values())
    raise ConfigError(f"{type(value).__name__} has no configuration; use one of {known}.")


def from_config(key: str, config: Any, where: str) -> Any:
    """Make a shape or background from what `to_config` returns; other fields have defaults.

    `key` is "shape" or "field", and `where` is the name of the dictionary in messages.
    """
    values = as_mapping(config, where)
    name, classes = values.pop(key, None), CLASSES[key]
    if not isinstance(name, str) or name not in classes:
        raise ConfigError(f"{where}: {key} is {name!r}; choose one of {', '.join(classes)}.")
    values = as_mapping(values, where, {field.name for field in fields(classes[name])})
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
    return to_config(value) if isinstance(value, _SHAPES) else value


def _nested(key: str, value: Any, where: str) -> Any:
    """Make shapes of dictionaries, alone or in a list."""
    if isinstance(value, Mapping):
        return from_config(key, value, where)
    if isinstance(value, Sequence) and any(isinstance(item, Mapping) for item in value):
        return [from_config(key, item, f"{where}[{i}]") for i, item in enumerate(value)]
    return value


def as_mapping(config: Any, where: str, known: Collection[str] = ()) -> dict[str, Any]:
    """Return a copy as a dictionary, or raise `ConfigError`; `known` are the accepted keys."""
    if not isinstance(config, Mapping):
        raise ConfigError(f"{where} is {config!r}; give a dictionary.")
    unknown = sorted(str(key) for key in config if known and key not in known)
    if unknown:
        raise ConfigError(
            f"{where}: unknown {', '.join(unknown)}; known are {', '.join(sorted(known))}."
        )
    return dict(config)

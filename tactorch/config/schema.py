"""Settings as plain values, for help, completion, documentation and checks of names.

A command's schema is a table that JSON holds, so that it can be stored: reading it imports none of
the components that it describes.
"""

import inspect
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from tactorch.config.options import Options, Setting, settings_of
from tactorch.config.registry import MISSING, REGISTRIES, Registry, plain_value
from tactorch.config.values import leaf_types
from tactorch.errors import ConfigError


def describe_settings(options: type, prefix: str = "") -> Iterator[dict[str, Any]]:
    """Yield the settings of a class, nested ones by their full names.

    Settings that are chosen by name from a registry are plain settings with the registry's names as
    choices.

    Args:
        options: Class of settings.
        prefix: Start of every name, such as "bounds.".
    """
    for setting in settings_of(options):
        nested = setting.nested
        if nested is not None and setting.constraint.section not in REGISTRIES:
            yield from describe_settings(nested, f"{prefix}{setting.name}.")
        else:
            yield _describe(setting, prefix)


def _describe(setting: Setting, prefix: str) -> dict[str, Any]:
    registry = REGISTRIES.get(setting.constraint.section)
    types = leaf_types(setting.annotation)
    names = setting.choices if registry is None else registry.names()
    default = default_of(setting)
    return {
        "name": f"{prefix}{setting.name}",
        "default": {"name": default} if _has_settings(registry) else default,
        "help": setting.constraint.help,
        "unit": setting.constraint.unit,
        "range": setting.constraint.describe(),
        "expectation": setting.expectation if registry is None else " or ".join(names),
        "choices": [text_of(name) for name in names],
        "is_path": Path in types,
        "is_table": dict in types or _has_settings(registry),
    }


def default_of(setting: Setting) -> Any:
    """Return the default as a plain value: a component by its name, "???" where there is none."""
    if setting.required:
        return MISSING
    registry, default = REGISTRIES.get(setting.constraint.section), setting.default
    if registry is not None and isinstance(default, Options):
        default = registry.name_of(type(default))
    return plain_value(default)


def _has_settings(registry: Registry | None) -> bool:
    """Return whether a component of a registry has settings, so that a name alone is no value."""
    if registry is None:
        return False
    return any(settings_of(registry[name]) for name in registry.names())


def tree_of(settings: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the defaults of described settings as a nested table."""
    tree: dict[str, Any] = {}
    for setting in settings:
        *tables, leaf = setting["name"].split(".")
        place = tree
        for table in tables:
            place = place.setdefault(table, {})
        place[leaf] = setting["default"]
    return tree


def with_values(
    settings: list[dict[str, Any]], values: Mapping[str, Any], source: str
) -> list[dict[str, Any]]:
    """Return described settings with other defaults.

    Args:
        settings: Described settings.
        values: New defaults, a nested table.
        source: File that they come from, for the message.

    Raises:
        ConfigError: a value is of a setting that does not exist.
    """
    by_name = {setting["name"]: setting for setting in settings}
    changed = dict(_leaves(values, by_name))
    unknown = [name for name in changed if name not in by_name]
    if unknown:
        raise ConfigError(f"'{source}' has the unknown setting '{unknown[0]}'; remove it.")
    return [{**s, "default": changed.get(s["name"], s["default"])} for s in settings]


def _leaves(
    values: Mapping[str, Any], known: Mapping[str, Any], prefix: str = ""
) -> Iterator[tuple[str, Any]]:
    for key, value in values.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping) and name not in known:
            yield from _leaves(value, known, f"{name}.")
        else:
            yield name, value


def summary_of(component: Any) -> str:
    """Return the first line of a component's docstring."""
    return (inspect.getdoc(component) or "").partition("\n\n")[0].replace("\n", " ").strip()


def text_of(value: Any) -> str:
    """Return a plain value as it is written in YAML and on the command line."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(text_of, value))}]"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key}: {text_of(v)}" for key, v in value.items()) + "}"
    return str(value)

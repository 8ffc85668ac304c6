"""Settings as typed, KEY=VALUE: checked against the schema before Hydra composes them."""

import difflib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tactorch.cli.schema import EXPERIMENT, Entry, Schema
from tactorch.config.registry import MISSING, missing_setting, unknown_choice
from tactorch.errors import ConfigError

if TYPE_CHECKING:
    from hydra.core.override_parser.types import Override

_HYDRA = ("hydra.", "hydra/")
#: Names of settings up to version 0.1, and their names now.
_RENAMED = {
    "most": "max_lumps",
    "start_mpa": "initialization.start_mpa",
    "press.hold": "press.support",
    "dataset.presses.hold": "dataset.presses.support",
    "dataset.sizes": "dataset.mesh",
    "material.parameters": "material",
}


def check_overrides(
    schema: Schema, words: Sequence[str], *, multirun: bool = False, trusted: bool = True
) -> list[str]:
    """Return settings as Hydra takes them.

    Args:
        schema: Schema of the command.
        words: Settings as typed.
        multirun: Whether settings may have several values.
        trusted: Whether settings of Hydra itself are accepted.

    Raises:
        ConfigError: a setting or an option of a group is unknown, or a word cannot be read.
    """
    words = [_renamed(word, schema) for word in words]
    overrides = [_parse(word, schema) for word in words]
    for override in overrides:
        if override.key_or_group in schema.defaults:
            _check_options(override, override.key_or_group, schema)
    entries, chosen = _reachable(schema, overrides)
    return [
        _checked(override, word, schema, entries, chosen, multirun, trusted)
        for override, word in zip(overrides, words, strict=True)
    ]


def check_required(schema: Schema, words: Sequence[str]) -> None:
    """Refuse that a setting without a default is not given.

    Raises:
        ConfigError: names the setting.
    """
    given = {key_of(word) for word in words}
    experiment = schema.experiments.get(schema.choices(words)[EXPERIMENT] or "", {})
    for entry in schema.settings:
        name = entry["name"]
        if entry["default"] == MISSING and name not in {*given, *experiment.get("values", ())}:
            message = missing_setting(name, entry["expectation"])
            raise ConfigError(f"{message} See tactorch {schema.command} --help.")


def key_of(word: str) -> str:
    """Return the name of the setting in a word."""
    return word.split("=", 1)[0].lstrip("+~")


def _renamed(word: str, schema: Schema) -> str:
    """Return a word with the present name of its setting."""
    key = word.partition("=")[0]
    for old, new in _RENAMED.items():
        name = key.lstrip("+")
        is_known = new.split(".")[0] in schema.groups or new == "max_lumps"
        if is_known and (name == old or name.startswith(f"{old}.")):
            return word.replace(old, new, 1)
    return word


def _parse(word: str, schema: Schema) -> "Override":
    from hydra.core.override_parser.overrides_parser import OverridesParser
    from hydra.errors import OverrideParseException

    key, equals, _ = word.partition("=")
    try:
        (override,) = OverridesParser.create().parse_overrides([word])
    except OverrideParseException as error:
        if not equals:
            raise ConfigError(_no_setting(word, schema)) from error
        reason = error.message.splitlines()[0]
        value = word.partition("=")[2]
        raise ConfigError(
            f"'{word}' cannot be read ({reason}); put a value with spaces, =, brackets or the like "
            f"in its own quotes: \"{key}='{value}'\"."
        ) from error
    if not equals and not override.is_delete():
        raise ConfigError(_no_setting(word, schema))
    return override


def _no_setting(word: str, schema: Schema) -> str:
    required = (e["name"] for e in schema.settings if e["default"] == MISSING)
    first = next(required, None)
    hint = f", here perhaps {first}={word}" if first and Path(word).exists() else ""
    return f"'{word}' is not a setting; write KEY=VALUE{hint}."


def _reachable(
    schema: Schema, overrides: Sequence["Override"]
) -> tuple[dict[str, Entry], dict[str, str | None]]:
    """Return the settings of all options that are chosen (in a sweep: of each), and the first."""
    chosen = {o.key_or_group: _values(o) for o in overrides if o.key_or_group in schema.defaults}
    first = {group: str(options[0]) for group, options in chosen.items() if options}
    resolved = schema.resolve(first)
    entries = schema.entries(resolved)
    for group, options in chosen.items():
        for option in options[1:]:
            entries |= schema.entries(schema.resolve({**first, group: str(option)}))
    return entries, resolved


def _values(override: "Override") -> list[Any]:
    """Return the value, or the values of a sweep that lists them."""
    if not override.is_sweep_override():
        return [override.value()]
    return list(override.sweep_string_iterator()) if override.is_discrete_sweep() else []


def _checked(
    override: "Override",
    word: str,
    schema: Schema,
    entries: Mapping[str, Entry],
    chosen: Mapping[str, str | None],
    multirun: bool,
    trusted: bool,
) -> str:
    key = override.get_key_element().lstrip("+~")
    if key.startswith(_HYDRA) and trusted:
        return word
    if override.is_sweep_override() and not multirun:
        value = word.partition("=")[2]
        raise ConfigError(
            f"'{word}' has several values: add -m to run with each, write {key}=[{value}] for a "
            f"list, or \"{key}='{value}'\" for one value with a comma in it."
        )
    if key in schema.defaults:
        pass
    elif table := _table_of(key, entries):
        plain = word.lstrip("+")
        return word if override.is_delete() else f"++{plain}" if key != table else plain
    else:
        _check_names(override, key, schema, entries, chosen)
    if override.is_delete():
        raise ConfigError(f"'{word}' would remove a setting; give it another value instead.")
    return word.lstrip("+")


def _check_options(override: "Override", group: str, schema: Schema) -> None:
    known = schema.options(group)
    for option in _values(override):
        is_none = group == EXPERIMENT and option in (None, "null")
        if option not in known and not is_none:
            raise ConfigError(unknown_choice(group, str(option), sorted(known)))


def _table_of(key: str, entries: Mapping[str, Entry]) -> str:
    """Return the setting with free keys that a key belongs to."""
    parts = key.split(".")
    names = (".".join(parts[:n]) for n in range(1, len(parts) + 1))
    return next((name for name in names if entries.get(name, {}).get("is_table")), "")


def _check_names(
    override: "Override",
    key: str,
    schema: Schema,
    entries: Mapping[str, Entry],
    chosen: Mapping[str, str | None],
) -> None:
    """Refuse an unknown name, and a table's name with a plain value."""
    if key in entries:
        return
    if not any(name.startswith(f"{key}.") for name in entries):
        raise ConfigError(unknown_setting(key, schema, entries, chosen))
    value = override.value()
    if not isinstance(value, Mapping):
        raise ConfigError(f"{key}={value}: it holds several settings; give {key}.KEY=VALUE.")
    for name in _leaves(value, f"{key}."):
        if name not in entries and not _table_of(name, entries):
            raise ConfigError(unknown_setting(name, schema, entries, chosen))


def _leaves(values: Mapping[Any, Any], prefix: str) -> Iterator[str]:
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}"


def unknown_setting(
    key: str, schema: Schema, entries: Mapping[str, Entry], chosen: Mapping[str, str | None]
) -> str:
    """Return the message for an unknown setting, with the one likely meant."""
    text = f"unknown setting '{key}'."
    group = key.split(".")[0]
    inside = [name for name in entries if name.startswith(f"{group}.")]
    match = nearest(key, [*entries, *schema.defaults])
    if match is not None:
        text += f" Did you mean '{match}'?"
    elif group in schema.groups and "." in key:
        names = ", ".join(name.removeprefix(f"{group}.") for name in inside) or "none"
        text += f" Settings of {group}={chosen.get(group)}: {names}."
    return f"{text} See tactorch {schema.command} --help."


def nearest(key: str, known: Sequence[str]) -> str | None:
    """Return the known name that a key most likely means: its group left out, or misspelt."""
    group, _, leaf = key.rpartition(".")
    inside = [name for name in known if group and name.startswith(f"{group}.")]
    # The last part of a name counts: in a group all names begin alike.
    leaves = {name.rpartition(".")[2]: name for name in reversed(inside or known)}
    matches = difflib.get_close_matches(leaf, list(leaves), n=1, cutoff=0.6 if inside else 0.75)
    return leaves[matches[0]] if matches else None

"""Settings as typed, KEY=VALUE: checked against the schema before Hydra composes them."""

import os
import re
import shlex
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from tactorch.budget import check_words
from tactorch.cli.presets import EXPERIMENT, Entry
from tactorch.cli.schema import Schema
from tactorch.config.registry import (
    NO_VALUE,
    missing_setting,
    unknown_choice,
    unknown_setting,
)
from tactorch.config.values import leaves
from tactorch.errors import ConfigError

if TYPE_CHECKING:
    from hydra.core.override_parser.types import Override

#: Settings of which leading words without a key are values: of the first word, and of the others.
POSITIONAL = {
    "evaluate": ("run", ""),
    "evaluate-model": ("run", ""),
    "find": ("run", ""),
    "mesh": ("surface", ""),
    "report": ("run", "compare"),
    "reproduce": ("exhibit", ""),
}


_KEY = re.compile(r"[+~]*[a-zA-Z_][\w./@-]*")


def named(command: str, words: Sequence[str]) -> list[str]:
    """Return the settings, with their keys put before the leading words that have none.

    Words beyond those that the command takes stay as they are, and are refused later.
    """
    first, others = POSITIONAL.get(command, ("", ""))
    limit = len(words) if others else int(bool(first))
    count = 0
    while count < min(limit, len(words)) and _is_value(words[count]):
        count += 1
    quoted = ["'{}'".format(w.replace("\\", r"\\").replace("'", r"\'")) for w in words[:count]]
    settings = [f"{first}={value}" for value in quoted[:1]]
    if len(quoted) > 1:
        settings.append(f"{others}=[{','.join(quoted[1:])}]")
    return [*settings, *words[count:]]


def _is_value(word: str) -> bool:
    """Return whether a word is no setting and no flag, but a name or a path, perhaps with a "="."""
    return word[:1] != "-" and ("=" not in word or os.path.exists(word))


def expanded(command: str, words: Sequence[str]) -> list[str]:
    """Return settings in which presser=MODULE:CLASS is written as the choice of a driver."""
    found: list[str] = []
    for word in words:
        key, _, value = word.partition("=")
        is_path = command == "live" and key == "presser" and ":" in value
        found += ["presser=driver", f"presser.path='{value}'"] if is_path else [word]
    return found


def check_overrides(
    schema: Schema, words: Sequence[str], *, multirun: bool = False, trusted: bool = True
) -> list[str]:
    """Return settings as Hydra takes them; Hydra's own settings only if they are trusted."""
    check_words(words)
    overrides = [_parse(word, schema) for word in words]
    groups = [o for o in overrides if o.key_or_group in schema.defaults]
    chosen = [(o.key_or_group, option) for o in groups for option in _values(o)]
    for group, option in chosen:
        known = schema.options(group)
        if option not in known and not (group == EXPERIMENT and option in (None, "null")):
            raise ConfigError(unknown_choice(group, str(option), sorted(known)))
    # The settings of all options that are chosen; a sweep chooses several.
    picked = {group: str(option) for group, option in chosen}
    choices = schema.resolve(picked)
    schema.check(choices)
    entries = schema.entries(choices)
    for group, option in chosen:
        entries |= schema.entries(schema.resolve({**picked, group: str(option)}))
    return [
        word
        if trusted and key_of(word).startswith(("hydra.", "hydra/"))
        else _checked(override, word, schema, entries, choices, multirun)
        for override, word in zip(overrides, words, strict=True)
    ]


def check_required(schema: Schema, words: Sequence[str]) -> None:
    """Refuse that a setting without a default is not given."""
    experiment = schema.experiments.get(schema.choices(words)[EXPERIMENT] or "", {})
    given = {*map(key_of, words), *experiment.get("values", ())}
    for entry in schema.settings:
        if entry["default"] == NO_VALUE and entry["name"] not in given:
            message = missing_setting(entry["name"], entry["expectation"])
            raise ConfigError(f"{message} See tactorch {schema.command} --help.")


def swept(schema: Schema, words: Sequence[str]) -> set[str]:
    """Return the keys of the settings of which a sweep lists several values."""
    settings = (word for word in words if not word.startswith("-"))
    overrides = [_parse(word, schema) for word in settings]
    return {o.get_key_element().lstrip("+~") for o in overrides if o.is_sweep_override()}


def key_of(word: str) -> str:
    """Return the name of the setting in a word."""
    return word.partition("=")[0].lstrip("+~")


def given(words: Sequence[str]) -> dict[str, str]:
    """Return the values of settings as typed, without quotes, by name."""
    return {key_of(word): word.partition("=")[2].strip("'\"") for word in words}


def _parse(word: str, schema: Schema) -> "Override":
    from hydra.core.override_parser.overrides_parser import OverridesParser
    from hydra.errors import OverrideParseException

    key, equals, value = word.partition("=")
    problem, override = "", None
    try:
        (override,) = OverridesParser.create().parse_overrides([word])
    except OverrideParseException as error:
        problem = error.message.splitlines()[0]
    exists = os.path.exists(word)  # Path.exists refuses what is too long for a path
    known = {e["name"].split(".")[0] for e in schema.settings} | set(schema.defaults)
    is_path = exists and key.lstrip("+~").split(".")[0] not in known
    if (not equals and (override is None or not override.is_delete())) or is_path:
        first = next((e["name"] for e in schema.settings if e["default"] == NO_VALUE), None)
        hint = f", here perhaps {_quoted(first, word)}" if first and exists else ""
        raise ConfigError(f"'{word}' is not a setting; write KEY=VALUE{hint}.")
    if override is None and not _KEY.fullmatch(key):
        raise ConfigError(f"'{word}' is neither a setting, KEY=VALUE, nor a path that exists.")
    if override is None:
        raise ConfigError(
            f"'{word}' cannot be read ({problem}); put a value with spaces, =, brackets or the "
            f"like in its own quotes: {_quoted(key, value)}."
        )
    return override


_PLAIN = re.compile(r"[\w/.:+@%-]*")  # values that need no quotes


def _quoted(key: str, value: str) -> str:
    """Return a setting as it is typed in a shell."""
    if "'" in value:
        return shlex.quote(f'{key}="{value}"')
    return f"{key}={value}" if _PLAIN.fullmatch(value) else f"\"{key}='{value}'\""


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
    choices: Mapping[str, str | None],
    multirun: bool,
) -> str:
    key, value = override.get_key_element().lstrip("+~"), word.partition("=")[2]
    if override.is_sweep_override() and not multirun:
        raise ConfigError(
            f"'{word}' has several values: add -m to run with each, write {key}=[{value}] for a "
            f"list, or \"{key}='{value}'\" for one value with a comma in it."
        )
    plain, table = word.lstrip("+"), _table_of(key, entries)
    if table and key not in schema.defaults:
        return word if override.is_delete() else f"++{plain}" if key != table else plain
    if key not in {*schema.defaults, *entries}:
        if not any(name.startswith(f"{key}.") for name in entries):
            raise ConfigError(_unknown_setting(key, schema, entries, choices))
        nested = override.value()
        if not isinstance(nested, Mapping):
            raise ConfigError(f"{key}={nested}: it holds several settings; give {key}.KEY=VALUE.")
        for name, _ in leaves(nested, prefix=f"{key}."):
            if name not in entries and not _table_of(name, entries):
                raise ConfigError(_unknown_setting(name, schema, entries, choices))
    if override.is_delete():
        raise ConfigError(f"'{word}' would remove a setting; give it another value instead.")
    return plain


def _table_of(key: str, entries: Mapping[str, Entry]) -> str:
    """Return the setting with free keys that a key belongs to."""
    parts = key.split(".")
    names = (".".join(parts[:n]) for n in range(1, len(parts) + 1))
    return next((name for name in names if entries.get(name, {}).get("is_table")), "")


def _unknown_setting(
    key: str, schema: Schema, entries: Mapping[str, Entry], choices: Mapping[str, str | None]
) -> str:
    group, dot, _ = key.partition(".")
    chosen = f"{group}={choices.get(group)}" if dot and group in schema.groups else ""
    message = unknown_setting(key, [*entries, *schema.defaults], f"{group}.", chosen)
    return f"{message} See tactorch {schema.command} --help."

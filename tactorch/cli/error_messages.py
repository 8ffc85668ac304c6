"""What Hydra complains of, as one line that says what to do."""

import argparse
import difflib
import re
from collections.abc import Sequence
from pathlib import Path

from tactorch.cli.catalog import Catalog

_UNKNOWN = re.compile(r"Could not (?:override|delete) '([^']*)'")


def complaint(error: Exception, verb: str, settings: Sequence[str]) -> str:
    """Return an error of Hydra's, raised before the command began, as one line."""
    from hydra.errors import MissingConfigException, OverrideParseException

    catalog = Catalog(verb)
    if isinstance(error, MissingConfigException) and error.options:
        return _unknown_option(str(error.missing_cfg_file), error.options)
    if isinstance(error, OverrideParseException):
        return _unreadable(error.override, error.message, catalog)
    if isinstance(error, OSError) and not isinstance(error, MissingConfigException):
        return f"the run folder cannot be made ({error}); choose another run_dir."
    text = str(error)
    if text.startswith("Ambiguous value"):
        return _ambiguous(text)
    unknown = _UNKNOWN.search(text)
    if unknown:
        return unknown_setting(unknown[1], catalog, settings)
    cause = f" ({_line(str(error.__cause__))})" if error.__cause__ else ""
    return _line(text) + cause


def unknown_flag(verb: str, settings: Sequence[str]) -> str:
    """Say which of Hydra's flags is none, or misused; empty where all are fine."""
    from hydra._internal.utils import get_args_parser

    flags = get_args_parser()
    flags.exit_on_error = False
    told: list[str] = []
    flags.error = told.append  # type: ignore[method-assign,assignment]
    try:
        flags.parse_args(settings)
    except argparse.ArgumentError as error:
        told.append(str(error))
    if not told:
        return ""
    return f"{_line(told[0])}; settings are KEY=VALUE, without dashes: see tactorch {verb} --help."


def unknown_setting(key: str, catalog: Catalog, settings: Sequence[str]) -> str:
    """Say that a setting is unknown, and which one may be meant."""
    choices = catalog.choices(settings)
    known = catalog.keys(choices)
    group = key.split(".")[0]
    option = choices.get(group)
    text = f"unknown setting '{key}'."
    near = nearest(key, known)
    if near is not None:
        text += f" Did you mean '{near}'?"
    elif option is not None and "." in key:
        names = ", ".join(catalog.option_keys(group, option)) or "none"
        text += f" Settings of {group}={option}: {names}."
    return f"{text} See tactorch {catalog.verb} --help."


def nearest(key: str, known: Sequence[str]) -> str | None:
    """Return the known name that `key` most likely means: its group forgotten, or misspelt."""
    group, _, leaf = key.rpartition(".")
    inside = [name for name in known if group and name.startswith(f"{group}.")]
    # The last part of a name counts: in a group all names begin alike.
    leaves = {name.rpartition(".")[2]: name for name in reversed(inside or known)}
    found = difflib.get_close_matches(leaf, list(leaves), n=1, cutoff=0.6 if inside else 0.75)
    return leaves[found[0]] if found else None


def did_you_mean(word: str, known: Sequence[str]) -> str:
    """Return a question to end a message with, or nothing."""
    lowered = {name.lower(): name for name in known}
    found = difflib.get_close_matches(word.lower(), lowered, n=1)
    return f" Did you mean '{lowered[found[0]]}'?" if found else ""


def _unknown_option(path: str, options: Sequence[str]) -> str:
    group, _, option = path.rpartition("/")
    choices = ", ".join(sorted(options))
    return f"{group}={option} is unknown; choose one of {choices}.{did_you_mean(option, options)}"


def _unreadable(setting: str, message: str, catalog: Catalog) -> str:
    key, equals, value = setting.partition("=")
    if not equals:
        needed = next((name for name, value in catalog.settings.items() if value == "???"), None)
        meant = f", here perhaps {needed}={setting}" if needed and Path(setting).exists() else ""
        return f"'{setting}' is not a setting; write KEY=VALUE{meant}."
    return (
        f"'{setting}' cannot be read ({message.splitlines()[0]}); put a value with spaces, =, "
        f"brackets or the like in quotes of its own: \"{key}='{value}'\"."
    )


def _ambiguous(text: str) -> str:
    setting = text.splitlines()[0].split("'", 1)[-1].rstrip("'")
    key, _, value = setting.partition("=")
    return (
        f"'{setting}' has several values: add -m to run with each, write {key}=[{value}] for a "
        f"list, or \"{key}='{value}'\" for one value with a comma in it."
    )


def _line(text: str) -> str:
    return " ".join(text.split())

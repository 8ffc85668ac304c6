"""`tactorch completion SHELL`: what a shell offers after TAB.

The shells' scripts call `tactorch completion words WORD...` (bash: `line LINE`) at each TAB. Only
the stored schema is read: Hydra's own completion composes settings, which takes four times as long.
"""

import os
import re
import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from tactorch.cli.commands import COMMANDS, GROUPS, VERBS
from tactorch.cli.help import describe_entry
from tactorch.cli.overrides import POSITIONAL
from tactorch.cli.schema import Schema, load_schema
from tactorch.errors import ConfigError

HELP = """\
tactorch completion: a script that makes a shell complete commands, settings, choices and files.

  bash  eval "$(tactorch completion bash)"        # in ~/.bashrc
  zsh   eval "$(tactorch completion zsh)"         # in ~/.zshrc, after compinit
  fish  tactorch completion fish > ~/.config/fish/completions/tactorch.fish"""

SHELLS = ("bash", "zsh", "fish")
WORDS, LINE = "words", "line"
_FLAGS = {
    "--help": "settings and options",
    "-m": "run every combination of values that are separated by commas",
    "--cfg": "print the settings of a run without running it",
    "--config-dir": "folder of your own presets and experiments",
}
_CFG = ("job", "hydra", "all")
# Start of a value before the item that is being typed: of a list, or of a sweep.
_PIECES = re.compile(r".*[\[,]")
# Characters with a meaning in Hydra's grammar.
_SPECIAL = set("""'"`,=()[]{}\\#!&|;<>~""")
_CURSOR = "_"


class Candidate(NamedTuple):
    """A word that completes what is typed, and its description."""

    word: str
    about: str = ""


def completed(words: Sequence[str]) -> list[Candidate]:
    """Return the candidates for the last of the words after `tactorch`, which may be empty."""
    *before, current = words or [""]
    return [c for c in _candidates(before, current) if c.word.startswith(current)]


def typed(line: str) -> list[str]:
    """Return the words after the command in a line that is cut off at the cursor.

    Within an open quotation there are no candidates: the list is empty.
    """
    try:
        *words, last = shlex.split(line + _CURSOR)
    except ValueError:
        return []
    return [*words[1:], last.removesuffix(_CURSOR)]


def _candidates(before: Sequence[str], current: str) -> Iterator[Candidate]:
    if not before:
        yield from map(Candidate._make, VERBS.items())
        if current:
            yield from (Candidate("--help", "the commands"), Candidate("--version"))
        return
    verb, given = before[0], list(before[1:])
    if verb == "help" and not given:
        yield from map(Candidate._make, VERBS.items())
    elif verb == "completion" and not given:
        yield from map(Candidate, SHELLS)
    elif verb == "doctor":
        yield Candidate("json=true", "for programs")
    elif verb in GROUPS and not given:
        yield from map(Candidate._make, GROUPS[verb].items())
    elif verb in GROUPS and f"{verb} {given[0]}" in COMMANDS:
        yield from _settings(f"{verb} {given[0]}", given[1:], current)
    elif verb in COMMANDS:
        if verb in POSITIONAL and not given and "=" not in current:
            yield from _values(load_schema(verb), given, POSITIONAL[verb][0], current)
        yield from _settings(verb, given, current)


def _settings(verb: str, given: Sequence[str], current: str) -> Iterator[Candidate]:
    """Flags, settings of a command, and values of a setting."""
    if current.startswith("-"):
        yield from map(Candidate._make, _FLAGS.items())
        return
    if given and given[-1] == "--cfg":
        yield from map(Candidate, _CFG)
        return
    schema = load_schema(verb)
    key, equals, value = current.partition("=")
    if equals:
        start = _PIECES.match(value)
        prefix = start[0] if start else ""
        for candidate in _values(schema, given, key, value.removeprefix(prefix)):
            yield Candidate(f"{key}={prefix}{candidate.word}", candidate.about)
        return
    used = {word.partition("=")[0] for word in given}
    yield from (c for c in _keys(schema, given, key) if c.word.rstrip("=") not in used)


def _keys(schema: Schema, given: Sequence[str], typed_key: str) -> Iterator[Candidate]:
    """Settings and groups; those within a group or a table once its name and a dot are typed."""
    prefix, dot, _ = typed_key.rpartition(".")
    choices = schema.choices(given)
    entries = schema.entries(choices)
    tables = {name.rpartition(".")[0] for name in entries if "." in name}
    names = [*(n for n in entries if n.rpartition(".")[0] == prefix)]
    names += [n for n in tables if n.rpartition(".")[0] == prefix and n not in schema.defaults]
    for key in dict.fromkeys(names if dot else [*names, *choices]):
        if key in entries:
            yield Candidate(f"{key}=", describe_entry(entries[key]))
        elif key in choices:
            yield Candidate(f"{key}=", f"now {choices[key] or 'none'}")
        if key in tables:
            yield Candidate(f"{key}.", "its settings")


def _values(schema: Schema, given: Sequence[str], key: str, value: str) -> Iterator[Candidate]:
    """Options of a group, or files and listed values of a setting."""
    if key in schema.defaults:
        for option, described in schema.options(key).items():
            yield Candidate(option, described["help"])
        return
    entry = schema.entries(schema.choices(given)).get(key)
    if entry is None:
        return
    yield from map(Candidate, entry["choices"])
    if entry["is_path"]:
        # The sensors that come with tactorch have names.
        folder = Path(__file__).parents[1] / "sensor" / "sensors"
        names = sorted(path.stem for path in folder.glob("*.yaml")) if key == "sensor" else ()
        yield from map(Candidate, (*names, *_files(value)))


def _files(prefix: str) -> Iterator[str]:
    """Files and folders next to a path that is being typed, except names that need quotes."""
    folder, name = os.path.split(prefix)
    try:
        entries = sorted(os.scandir(folder or "."), key=lambda entry: entry.name)
    except OSError:
        return
    for entry in entries:
        hidden = entry.name.startswith(".") and not name.startswith(".")
        if not hidden and not _SPECIAL & set(entry.name):
            yield os.path.join(folder, entry.name) + ("/" if entry.is_dir() else "")


def run(words: Sequence[str]) -> None:
    """Print a shell's script, or candidates: one per line, with its description after a tab.

    Raises:
        ConfigError: the shell is unknown.
    """
    request, given = (words[0], words[1:]) if words else ("", ())
    if request in (WORDS, LINE):
        line = typed(given[0]) if request == LINE and given else list(given)
        for candidate in completed(line) if line else ():
            print("\t".join(part for part in candidate if part))
    elif request in SHELLS and not given:
        print(script(request), end="")
    else:
        problem = f"'{' '.join(words)}' is not a known shell" if words else "name a shell"
        raise ConfigError(f"{problem}; choose one of {', '.join(SHELLS)}.")


def script(shell: str) -> str:
    """Return the script that makes a shell complete the command."""
    return (Path(__file__).parent / "shells" / f"tactorch.{shell}").read_text(encoding="utf-8")

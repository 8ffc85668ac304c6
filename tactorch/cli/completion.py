"""`tactorch completion SHELL`: what a shell offers after TAB.

The shells' scripts ask `tactorch completion words WORD...` (bash: `line LINE`) at each TAB. Only
files of settings are read: Hydra's own completion, which composes them, takes four times as long.
"""

import os
import re
import shlex
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from tactorch.cli.catalog import Catalog
from tactorch.errors import ConfigError

HELP = """\
tactorch completion: a script that makes a shell complete commands, settings, choices and files.

  bash  eval "$(tactorch completion bash)"        # in ~/.bashrc
  zsh   eval "$(tactorch completion zsh)"         # in ~/.zshrc, after compinit
  fish  tactorch completion fish > ~/.config/fish/completions/tactorch.fish"""

SHELLS = ("bash", "zsh", "fish")
WORDS, LINE = "words", "line"
_FLAGS = {
    "--help": "its settings, and what each option is",
    "-m": "run every combination of values that are separated by commas",
    "--cfg": "print the settings of a run without running it",
}
_CFG = ("job", "hydra", "all")
# What stands in a value before the piece that is being typed: of a list, or of a sweep.
_PIECES = re.compile(r".*[\[,]")
# What Hydra would take for more than a name.
_SPECIAL = set("""'"`,=()[]{}\\#!&|;<>~""")
_CURSOR = "_"
# The values in a comment, as `squares | huber (outlying markers) | adaptive`.
_VALUES = re.compile(r"(?:^|\| )([A-Za-z0-9_+-]+)(?= \(| \||$|:)")


class Candidate(NamedTuple):
    """A word that may be meant, and what it is."""

    word: str
    about: str = ""


def completed(words: Sequence[str]) -> list[Candidate]:
    """Return what the last of the words, which may be empty, may become.

    Args:
        words: What is typed after `tactorch`.
    """
    *before, current = words or [""]
    return [c for c in _candidates(before, current) if c.word.startswith(current)]


def typed(line: str) -> list[str]:
    """Return the words after the command in a line that is cut off at the cursor.

    Within a quotation that is still open there is nothing to offer: no word.
    """
    try:
        *words, last = shlex.split(line + _CURSOR)
    except ValueError:
        return []
    return [*words[1:], last.removesuffix(_CURSOR)]


def _candidates(before: Sequence[str], current: str) -> Iterator[Candidate]:
    from tactorch.cli.main import COMMANDS, GROUPS, VERBS
    from tactorch.cli.positional import POSITIONAL

    if not before:
        yield from (Candidate(*pair) for pair in VERBS.items())
        if current:
            yield from (Candidate("--help", "what there is"), Candidate("--version"))
        return
    verb, given = before[0], list(before[1:])
    if verb == "help" and not given:
        yield from (Candidate(*pair) for pair in VERBS.items())
    elif verb == "completion" and not given:
        yield from map(Candidate, SHELLS)
    elif verb == "doctor":
        yield Candidate("json=true", "for programs")
    elif verb in GROUPS and not given:
        yield from (Candidate(*pair) for pair in GROUPS[verb].items())
    elif verb in GROUPS and f"{verb} {given[0]}" in COMMANDS:
        yield from _settings(f"{verb} {given[0]}", given[1:], current)
    elif verb in COMMANDS:
        if verb in POSITIONAL and not given and "=" not in current:
            yield from _values(Catalog(verb), given, POSITIONAL[verb].first, current)
        yield from _settings(verb, given, current)


def _settings(verb: str, given: Sequence[str], current: str) -> Iterator[Candidate]:
    """Flags, settings of a command, and values of a setting."""
    if current.startswith("-"):
        yield from (Candidate(*pair) for pair in _FLAGS.items())
        return
    if given and given[-1] == "--cfg":
        yield from map(Candidate, _CFG)
        return
    catalog = Catalog(verb)
    key, equals, value = current.partition("=")
    if equals:
        head = _PIECES.match(value)
        begun = head[0] if head else ""
        for candidate in _values(catalog, given, key, value.removeprefix(begun)):
            yield Candidate(f"{key}={begun}{candidate.word}", candidate.about)
        return
    known = {word.partition("=")[0] for word in given}
    yield from (c for c in _keys(catalog, given, key) if c.word.rstrip("=") not in known)


def _keys(catalog: Catalog, given: Sequence[str], typed_key: str) -> Iterator[Candidate]:
    """Settings and groups; those within a group, or a table, once its name and a dot are there."""
    table, dot, _ = typed_key.rpartition(".")
    choices = catalog.choices(given)
    keys = catalog.keys(choices)
    within = [key for key in keys if key.rpartition(".")[0] == table]
    nests = {key.rpartition(".")[0] for key in keys}
    about = _comments(catalog, choices)
    for key in dict.fromkeys(within if dot else [*within, *choices]):
        if key not in nests or key in choices:
            yield Candidate(f"{key}=", about.get(key, ""))
        if key in nests:
            yield Candidate(f"{key}.", "its settings")


def _values(catalog: Catalog, given: Sequence[str], key: str, value: str) -> Iterator[Candidate]:
    """Options of a group, files, or the values that the settings' comment names."""
    from tactorch.cli.kinds import FLAG, PATH, PATHS, kind_of

    if key in catalog.defaults:
        options = catalog.options(key)
        yield from (Candidate(option, catalog.about(key, option)) for option in options)
        return
    kind = kind_of(key)
    if kind is FLAG:
        yield from map(Candidate, ("true", "false"))
    elif kind in (PATH, PATHS):
        yield from map(Candidate, _sensors() if key == "sensor" else ())
        yield from map(Candidate, _files(value))
    comment = _comments(catalog, catalog.choices(given)).get(key, "")
    if " | " in comment:
        yield from map(Candidate, _VALUES.findall(comment))


def _files(begin: str) -> Iterator[str]:
    """Files and folders whose path begins so; names that Hydra wants quoted are passed over."""
    folder, name = os.path.split(begin)
    try:
        entries = sorted(os.scandir(folder or "."), key=lambda entry: entry.name)
    except OSError:
        return
    for entry in entries:
        hidden = entry.name.startswith(".") and not name.startswith(".")
        if not hidden and not _SPECIAL & set(entry.name):
            yield os.path.join(folder, entry.name) + ("/" if entry.is_dir() else "")


def _sensors() -> list[str]:
    """Names of the sensors that come with tactorch."""
    folder = Path(__file__).parents[1] / "sensor" / "description"
    return sorted(path.stem for path in folder.glob("*.yaml"))


def _comments(catalog: Catalog, choices: Mapping[str, str | None]) -> dict[str, str]:
    """What the files of settings say beside each."""
    found = dict(_said(catalog.text))
    for group, option in choices.items():
        if option is not None and group != "experiment":
            found[group] = f"now {option}"
            text = catalog.option_text(group, option)
            found |= {f"{group}.{key}": comment for key, comment in _said(text)}
    return found


def _said(text: str) -> Iterator[tuple[str, str]]:
    """Full names and comments of the settings in a file."""
    above: list[tuple[int, str]] = []
    for line in text.splitlines():
        found = re.match(r"( *)([A-Za-z_]\w*):(?:[^#]*?#\s*(.*))?", line)
        if found:
            indent = len(found[1])
            above = [*(pair for pair in above if pair[0] < indent), (indent, found[2])]
            yield ".".join(name for _, name in above), found[3] or ""


def run(words: Sequence[str]) -> None:
    """Print a shell's script, or candidates, one to a line and what each is after a tab.

    Raises:
        ConfigError: It is no shell that is known.
    """
    what, given = (words[0], words[1:]) if words else ("", ())
    if what in (WORDS, LINE):
        asked = typed(given[0]) if what == LINE and given else list(given)
        for candidate in completed(asked) if asked else ():
            print("\t".join(part for part in candidate if part))
    elif what in SHELLS and not given:
        print(script(what), end="")
    else:
        told = f"'{' '.join(words)}' is no shell that is known" if words else "name a shell"
        raise ConfigError(f"{told}; choose one of {', '.join(SHELLS)}.")


def script(shell: str) -> str:
    """Return what makes a shell complete the command."""
    return (Path(__file__).parent / "shells" / f"tactorch.{shell}").read_text(encoding="utf-8")

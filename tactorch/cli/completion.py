"""`tactorch completion SHELL`: what a shell offers after TAB.

The shells' scripts call `tactorch completion words WORD...` (bash: `line LINE`) at each TAB. Only
the stored schema is read: Hydra's own completion composes settings, which takes four times as long.
"""

import os
import re
import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path

from tactorch.cli import COMMANDS, GROUPS, VERBS
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
_CFG = dict.fromkeys(("job", "hydra", "all"), "")
#: What follows a verb that has no settings.
_NEXT_WORDS = {"help": VERBS, "completion": dict.fromkeys(SHELLS, ""), **GROUPS}
# Start of a value before the item that is being typed: of a list, or of a sweep.
_PIECES = re.compile(r".*[\[,]")
# Characters with a meaning in Hydra's grammar.
_SPECIAL = set("""'"`,=()[]{}\\#!&|;<>~""")
_CURSOR = "_"


def completed(words: Sequence[str]) -> dict[str, str]:
    """Return the candidates for the last of the words after `tactorch`, with descriptions."""
    *before, current = words or [""]
    candidates = _candidates(before, current).items()
    return {word: text for word, text in candidates if word.startswith(current)}


def typed(line: str) -> list[str]:
    """Return the words after the command in a line that is cut off at the cursor.

    Within an open quotation there are no candidates: the list is empty.
    """
    try:
        *words, last = shlex.split(line + _CURSOR)
    except ValueError:
        return []
    return [*words[1:], last.removesuffix(_CURSOR)]


def _candidates(before: Sequence[str], current: str) -> dict[str, str]:
    if not before:
        return {**VERBS, **({"--help": "the commands", "--version": ""} if current else {})}
    verb, *given = before
    if verb in _NEXT_WORDS and not given:
        return _NEXT_WORDS[verb]
    if verb == "doctor":
        return {"json=true": "for programs"}
    if verb in GROUPS:
        verb = f"{verb} {given.pop(0)}"
    if verb not in COMMANDS:
        return {}
    if current.startswith("-"):
        return _FLAGS
    if given and given[-1] == "--cfg":
        return _CFG
    schema = load_schema(verb)
    key, equals, value = current.partition("=")
    if equals:
        start = _PIECES.match(value)
        prefix = start[0] if start else ""
        values = _values(schema, given, key, value.removeprefix(prefix)).items()
        return {f"{key}={prefix}{word}": text for word, text in values}
    used = {word.partition("=")[0] for word in given}
    keys = {k: v for k, v in _keys(schema, given, key).items() if k.rstrip("=") not in used}
    if verb in POSITIONAL and not given:
        return _values(schema, given, POSITIONAL[verb][0], current) | keys
    return keys


def _keys(schema: Schema, given: Sequence[str], typed_key: str) -> dict[str, str]:
    """Settings and groups; those within a group or a table once its name and a dot are typed."""
    prefix, dot, _ = typed_key.rpartition(".")
    choices = schema.choices(given)
    entries = schema.entries(choices)
    tables = dict.fromkeys(name.rpartition(".")[0] for name in entries if "." in name)
    names = [*entries, *(name for name in tables if name not in schema.defaults)]
    names = [name for name in names if name.rpartition(".")[0] == prefix]
    keys = {}
    for key in names if dot else [*names, *choices]:
        if key in entries:
            keys[f"{key}="] = describe_entry(entries[key])
        elif key in choices:
            keys[f"{key}="] = f"now {choices[key] or 'none'}"
        if key in tables:
            keys[f"{key}."] = "its settings"
    return keys


def _values(schema: Schema, given: Sequence[str], key: str, value: str) -> dict[str, str]:
    """Options of a group, or files and listed values of a setting."""
    if key in schema.defaults:
        return {option: described["help"] for option, described in schema.options(key).items()}
    entry = schema.entries(schema.choices(given)).get(key, {"choices": (), "is_path": False})
    words = list(entry["choices"])
    if entry["is_path"]:
        if key == "sensor":  # the ones that come with tactorch have names
            folder = Path(__file__).parents[1] / "sensor" / "sensors"
            words += sorted(path.stem for path in folder.glob("*.yaml"))
        words += _files(value)
    return dict.fromkeys(words, "")


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
    """Print a shell's script, or candidates: one per line, with its description after a tab."""
    request, given = (words[0], words[1:]) if words else ("", ())
    if request in (WORDS, LINE):
        line = typed(given[0]) if request == LINE and given else list(given)
        for candidate in completed(line).items() if line else ():
            print("\t".join(filter(None, candidate)))
    elif request in SHELLS and not given:
        print(script(request), end="")
    else:
        problem = f"'{' '.join(words)}' is not a known shell" if words else "name a shell"
        raise ConfigError(f"{problem}; choose one of {', '.join(SHELLS)}.")


def script(shell: str) -> str:
    """Return the script that makes a shell complete the command."""
    return (Path(__file__).parent / "shells" / f"tactorch.{shell}").read_text(encoding="utf-8")

"""`tactorch COMMAND --help`: settings with their help, and the options of each group."""

import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import takewhile
from typing import Any

from tactorch.cli.presets import EXPERIMENT, Entry
from tactorch.cli.schema import load_schema, text_of

_WIDTH = 98
_FOOTER = """\
-m runs every combination of values separated by commas, each in its own folder (0, 1, ...) in
run_dir. --cfg job prints the settings of a run without running it. --config-dir FOLDER adds presets
and experiments of your own. A path with spaces, commas, = or brackets needs its own quotes:
"path='a (1).h5'".\
"""


def help_text(command: str, words: Sequence[str] = ()) -> str:
    """Return the help of a command; settings are those of the options that the words choose."""
    schema = load_schema(command)
    choices = schema.choices(words)
    known = {g: o for g, o in choices.items() if o is None or o in schema.options(g)}
    for group, option in known.items():  # imported where it is of another package
        schema.component(group, option)
    parts = [schema.header, "Settings (KEY=VALUE) and their defaults:"]
    parts.append("\n".join(_settings(schema.settings, "  ")))
    groups = [line for g, o in known.items() for line in _group(schema.options(g), g, o)]
    if groups:
        parts += ["Groups (GROUP=OPTION); * marks what is chosen:", "\n".join(groups)]
    chosen: list[str] = []
    for group, option in known.items():
        settings = schema.component(group, option)["settings"]
        if settings and group != EXPERIMENT:
            chosen += [f"  {group}: ({option})", *_settings(settings, "    ")]
    if chosen:
        parts += ["Settings of these options (GROUP.KEY=VALUE):", "\n".join(chosen)]
    return "\n\n".join((*parts, _FOOTER))


def describe_entry(entry: Entry) -> str:
    """Return the help of a setting with its choices, range and unit."""
    choices = [choice for choice in entry["choices"] if choice not in ("true", "false")]
    values = f": {' | '.join(choices)}" if len(choices) > 1 else ""
    notes = ", ".join(note for note in (entry["range"], entry["unit"]) if note)
    return entry["help"] + (f" ({notes})" if notes else "") + values


def _settings(settings: Iterable[Entry], indent: str) -> Iterator[str]:
    """Yield the settings as YAML with comments, those of a table under its name."""
    table = ""
    for entry in settings:
        outer, _, leaf = entry["name"].rpartition(".")
        if outer and outer != table:
            yield f"{indent}{outer}:"
        table = outer
        inner, comment = indent + ("  " if outer else ""), describe_entry(entry)
        head = f"{inner}{leaf}: {text_of(entry['default'])}"
        if len(head) + len(comment) + 4 <= _WIDTH:
            yield f"{head}  # {comment}".removesuffix("  # ")
            continue
        yield head
        start = f"{inner}    # "
        yield from textwrap.wrap(comment, _WIDTH, initial_indent=start, subsequent_indent=start)


def _group(options: Mapping[str, Any], group: str, chosen: str | None) -> Iterator[str]:
    """Yield the name of a group and its options with their help."""
    width = max(map(len, options), default=0)
    if options:
        yield f"  {group}"
    for option, described in options.items():
        head = f"  {'*' if option == chosen else ' '} {option:<{width}}  "
        rest = " " * len(head)
        text = textwrap.fill(described["help"], _WIDTH, initial_indent=head, subsequent_indent=rest)
        yield text or head.rstrip()


def wants_help(words: Sequence[str]) -> bool:
    """Return whether help is requested."""
    flags = takewhile(lambda word: word != "--", words)
    return any(flag in ("-h", "--help") for flag in flags)

"""`tactorch COMMAND --help`: settings with their help, and the options of each group."""

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from itertools import takewhile

from tactorch.cli.schema import EXPERIMENT, Entry, Schema, load_schema
from tactorch.config.schema import text_of

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
    parts = [
        schema.header,
        "Settings (KEY=VALUE) and their defaults:",
        "\n".join(_lines(schema.settings, "  ")),
    ]
    groups = [_group(schema, g, o) for g, o in known.items() if schema.options(g)]
    if groups:
        parts += ["Groups (GROUP=OPTION); * marks what is chosen:", "\n".join(groups)]
    chosen = list(_chosen(schema, known))
    if chosen:
        parts += ["Settings of these options (GROUP.KEY=VALUE):", "\n".join(chosen)]
    return "\n\n".join((*parts, _FOOTER))


def about(entry: Entry) -> str:
    """Return the help of a setting with its choices, range and unit."""
    choices = [choice for choice in entry["choices"] if choice not in ("true", "false")]
    values = " | ".join(choices) if len(choices) > 1 else ""
    notes = [note for note in (entry["range"], entry["unit"]) if note]
    text = entry["help"] + (f" ({', '.join(notes)})" if notes else "")
    return f"{text}: {values}" if values else text


def _lines(settings: Iterable[Entry], indent: str) -> Iterable[str]:
    """Yield the settings as YAML with comments, those of a table under its name."""
    table = ""
    for entry in settings:
        outer, _, leaf = entry["name"].rpartition(".")
        if outer and outer != table:
            yield f"{indent}{outer}:"
        table = outer
        head = f"{indent}{'  ' if outer else ''}{leaf}: {text_of(entry['default'])}"
        yield from _commented(head, about(entry))


def _commented(head: str, comment: str) -> Iterable[str]:
    if len(head) + len(comment) + 4 <= _WIDTH or not comment:
        yield f"{head}  # {comment}".removesuffix("  # ")
        return
    indent = " " * (len(head) - len(head.lstrip()) + 4)
    yield head
    for line in textwrap.wrap(comment, _WIDTH - len(indent) - 2):
        yield f"{indent}# {line}"


def _group(schema: Schema, group: str, chosen: str | None) -> str:
    options = schema.options(group)
    width = max(map(len, options))
    lines = [f"  {group}"]
    for option, described in options.items():
        head = f"  {'*' if option == chosen else ' '} {option:<{width}}  "
        wrapped = textwrap.wrap(described["help"], _WIDTH - len(head)) or [""]
        lines += [(head + wrapped[0]).rstrip()]
        lines += [" " * len(head) + line for line in wrapped[1:]]
    return "\n".join(lines)


def _chosen(schema: Schema, choices: Mapping[str, str | None]) -> Iterable[str]:
    for group, option in choices.items():
        settings = schema.option_settings(group, option)
        if settings and group != EXPERIMENT:
            yield f"  {group}: ({option})"
            yield from _lines(settings, "    ")


def wants_help(words: Sequence[str]) -> bool:
    """Return whether help is requested."""
    flags = takewhile(lambda word: word != "--", words)
    return any(flag in ("-h", "--help") for flag in flags)

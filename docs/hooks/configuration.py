"""The configuration reference: every command, group and setting, read from the schema."""

import html
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from tactorch.cli import COMMANDS
from tactorch.cli.presets import EXPERIMENT
from tactorch.cli.schema import Schema, app_name, load_schema, text_of

_INTRODUCTION = """\
# Configuration reference

Every setting of every command, with a page for each command and each group. They are generated from
the typed settings of the code each time the documentation is built; `tactorch COMMAND --help` shows
the same in a terminal.

- A setting is given as `KEY=VALUE`, one in a group as `GROUP.KEY=VALUE`, an option of a group as
  `GROUP=OPTION`. `experiment=NAME` changes several settings at once.
- `???` marks a required setting. `null` means none, or determined by the program, as the comment
  says; where it is allowed the column "value" says "or null".
- `-m` runs all combinations of values that are separated by commas.
- `--cfg job` prints the settings of a run without running it.
- `--config-dir FOLDER` adds presets and experiments from a folder: `FOLDER/GROUP/NAME.yaml` holds
  the settings that differ from the defaults, and `name: COMPONENT` in groups of components, or
  `_target_: MODULE.CLASS` for one of a package that `--trust PACKAGE` names (see [Extend
  tactorch](../howto/extensions.md)). Other settings are plain; `--trust-config-dir` gives the
  folder to Hydra as it is, which can run programs.
- The same names, defaults and checks apply in Python: `Settings(regularization={"name": "matern",
  "length_mm": 2.0})`.
"""


_FOLDER = "configuration"


def pages() -> dict[str, str]:
    """Return the pages of the reference, by path, as Markdown."""
    schemas = {command: load_schema(command) for command in COMMANDS}
    made = {"index.md": f"{_INTRODUCTION}\n\n{_overview(schemas)}"}
    made |= {_file(command): _command(schema) for command, schema in schemas.items()}
    made |= {f"group-{group}.md": _group(group, schemas) for group in _groups(schemas)}
    made[f"{EXPERIMENT}s.md"] = _experiments(schemas)
    return {f"{_FOLDER}/{name}": f"{text}\n" for name, text in made.items()}


def navigation() -> list[Any]:
    """Return the entries of the pages in the site's navigation."""
    schemas = {command: load_schema(command) for command in COMMANDS}
    groups = [f"{_FOLDER}/group-{group}.md" for group in _groups(schemas)]
    return [
        {"Overview": f"{_FOLDER}/index.md"},
        {"Commands": [f"{_FOLDER}/{_file(command)}" for command in schemas]},
        {"Groups": [*groups, f"{_FOLDER}/{EXPERIMENT}s.md"]},
    ]


def _groups(schemas: Mapping[str, Schema]) -> list[str]:
    return sorted({group for schema in schemas.values() for group in schema.groups})


def _overview(schemas: Mapping[str, Schema]) -> str:
    rows = ["| command | purpose | groups |", "|---|---|---|"]
    for command, schema in schemas.items():
        purpose = schema.header.splitlines()[0].partition(": ")[2].rstrip(".")
        groups = ", ".join(f"[{group}](group-{group}.md)" for group in schema.groups)
        rows.append(f"| [{command}]({_file(command)}) | {purpose} | {groups} |")
    return "\n".join(rows)


def _file(command: str) -> str:
    return f"{app_name(command)}.md"


def _command(schema: Schema) -> str:
    parts = [f"# tactorch {schema.command}"]
    parts.append(f"```text\n{schema.header}\n```")
    parts.append(table(schema.settings))
    if schema.groups:
        chosen = (
            f"[{g}](group-{g}.md) = `{found['default']}`" for g, found in schema.groups.items()
        )
        parts.append(f"Groups and their defaults: {', '.join(chosen)}.")
    return "\n\n".join(parts)


def _group(group: str, schemas: Mapping[str, Schema]) -> str:
    users = {command: s.groups[group] for command, s in schemas.items() if group in s.groups}
    links = ", ".join(f"[{command}]({_file(command)})" for command in users)
    found = next(iter(users.values()))
    parts = [f"# {group}", f"{found['help']}. Used by {links}."]
    for option, described in found["options"].items():
        text = html.escape(described["help"], False)
        parts.append(f"## {group}={option} {{#{group}-{option}}}\n\n{text}")
        overrides = described["overrides"].items()
        if overrides:
            links = ", ".join(f"[{g}={o}](group-{g}.md#{g}-{o})" for g, o in overrides)
            parts.append(f"Chooses {links} too.")
        if described["settings"]:
            parts.append(table(described["settings"], f"{group}."))
    return "\n\n".join(parts)


def _experiments(schemas: Mapping[str, Schema]) -> str:
    found = {name: e for schema in schemas.values() for name, e in schema.experiments.items()}
    parts = [
        "# Experiments",
        "`experiment=NAME` chooses one. Each changes several settings at once.",
    ]
    for name, described in sorted(found.items()):
        words = [f"{group}={option}" for group, option in described["overrides"].items()]
        words += [f"{key}={text_of(value)}" for key, value in _leaves(described["values"])]
        text = html.escape(described["help"], False)
        parts.append(f"## {EXPERIMENT}={name}\n\n{text}\n\n```text\n{' '.join(words)}\n```")
    return "\n\n".join(parts)


def _leaves(values: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, object]]:
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def table(settings: Sequence[Mapping[str, Any]], prefix: str = "") -> str:
    """Return described settings as a table, their names with a prefix."""
    rows = ["| setting | default | value | comment |", "|---|---|---|---|"]
    for entry in settings:
        unit = f", {entry['unit']}" if entry["unit"] else ""
        cells = (
            f"`{prefix}{entry['name']}`",
            f"`{text_of(entry['default'])}`",
            f"{entry['expectation']}{unit}",
            html.escape(entry["help"], False),
        )
        rows.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(rows)

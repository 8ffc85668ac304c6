"""The configuration reference: every command, group and setting, read from the schema."""

import html
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from tactorch.cli import COMMANDS
from tactorch.cli.presets import EXPERIMENT
from tactorch.cli.schema import Schema, app_name, load_schema, text_of

_INTRODUCTION = """\
# Configuration reference

Every setting of every command. This page is generated from the typed settings of the code each time
the documentation is built; `tactorch COMMAND --help` shows the same in a terminal.

- A setting is given as `KEY=VALUE`, one in a group as `GROUP.KEY=VALUE`, an option of a group as
  `GROUP=OPTION`. `experiment=NAME` changes several settings at once.
- `???` marks a required setting. `null` means none, or determined by the program, as the comment
  says; where it is allowed the column "value" says "or null".
- `-m` runs all combinations of values that are separated by commas.
- `--cfg job` prints the settings of a run without running it.
- `--config-dir FOLDER` adds presets and experiments from a folder: `FOLDER/GROUP/NAME.yaml` holds
  the settings that differ from the defaults, and `name: COMPONENT` in groups of components, or
  `_target_: MODULE.CLASS` for one of a package that `--trust PACKAGE` names (see [Extend
  tactorch](howto/extensions.md)). Other settings are plain; `--trust-config-dir` gives the folder
  to Hydra as it is, which can run programs.
- The same names, defaults and checks apply in Python: `Settings(regularization={"name": "matern",
  "length_mm": 2.0})`.
"""


def page() -> str:
    """Return the whole reference as Markdown."""
    schemas = {command: load_schema(command) for command in COMMANDS}
    groups = sorted({group for schema in schemas.values() for group in schema.groups})
    parts = [_INTRODUCTION, _overview(schemas), "## Commands"]
    parts += [_command(schema) for schema in schemas.values()]
    parts += ["## Groups", *(_group(group, schemas) for group in groups), _experiments(schemas)]
    return "\n\n".join(parts) + "\n"


def _overview(schemas: Mapping[str, Schema]) -> str:
    rows = ["| command | purpose | groups |", "|---|---|---|"]
    for command, schema in schemas.items():
        purpose = schema.header.splitlines()[0].partition(": ")[2].rstrip(".")
        groups = ", ".join(f"[{group}](#{group})" for group in schema.groups)
        rows.append(f"| [{command}](#{_anchor(command)}) | {purpose} | {groups} |")
    return "\n".join(rows)


def _anchor(command: str) -> str:
    return f"tactorch-{app_name(command)}"


def _command(schema: Schema) -> str:
    parts = [f"### tactorch {schema.command} {{#{_anchor(schema.command)}}}"]
    parts.append(f"```text\n{schema.header}\n```")
    parts.append(table(schema.settings))
    if schema.groups:
        chosen = (f"[{g}](#{g}) = `{found['default']}`" for g, found in schema.groups.items())
        parts.append(f"Groups and their defaults: {', '.join(chosen)}.")
    return "\n\n".join(parts)


def _group(group: str, schemas: Mapping[str, Schema]) -> str:
    users = {command: s.groups[group] for command, s in schemas.items() if group in s.groups}
    links = ", ".join(f"[{command}](#{_anchor(command)})" for command in users)
    found = next(iter(users.values()))
    parts = [f"### {group}", f"{found['help']}. Used by {links}."]
    for option, described in found["options"].items():
        text = html.escape(described["help"], False)
        parts.append(f"#### {group}={option} {{#{group}-{option}}}\n\n{text}")
        overrides = described["overrides"].items()
        if overrides:
            links = ", ".join(f"[{g}={o}](#{g}-{o})" for g, o in overrides)
            parts.append(f"Chooses {links} too.")
        if described["settings"]:
            parts.append(table(described["settings"], f"{group}."))
    return "\n\n".join(parts)


def _experiments(schemas: Mapping[str, Schema]) -> str:
    found = {name: e for schema in schemas.values() for name, e in schema.experiments.items()}
    parts = [f"### {EXPERIMENT}", "Each changes several settings at once."]
    for name, described in sorted(found.items()):
        words = [f"{group}={option}" for group, option in described["overrides"].items()]
        words += [f"{key}={text_of(value)}" for key, value in _leaves(described["values"])]
        text = html.escape(described["help"], False)
        parts.append(f"#### {EXPERIMENT}={name}\n\n{text}\n\n```text\n{' '.join(words)}\n```")
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

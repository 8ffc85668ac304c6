"""The configuration reference: every command, group and setting, read from the files in conf/.

What the pages say stands in those files: defaults, comments, and in `tactorch.cli.kinds` which kind
of value is taken. Nothing of it is written twice.
"""

import html
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import yaml

from tactorch.cli.catalog import Catalog, app_name
from tactorch.cli.kinds import KINDS, OPTIONAL
from tactorch.cli.main import COMMANDS

_INTERNAL = ("defaults", "hydra", "name")
_EXPERIMENT = "experiment"


@dataclass(frozen=True)
class Setting:
    """A line of a settings file: name, default as it stands there, and its comment."""

    name: str
    default: str
    comment: str


def settings_of(text: str) -> Iterator[Setting]:
    """Yield the settings of a file, nested ones by their full names, with their comments.

    A comment counts for the setting beside it; one on lines of its own, for what follows it.
    """
    root = yaml.compose(text)
    if isinstance(root, yaml.MappingNode):
        yield from _settings(root, text.splitlines(), "")


def _settings(node: yaml.MappingNode, lines: list[str], prefix: str) -> Iterator[Setting]:
    for key, value in node.value:
        if not prefix and key.value in _INTERNAL:
            continue
        name = f"{prefix}{key.value}"
        comment = _comment(lines, key, value)
        if isinstance(value, yaml.MappingNode) and not value.flow_style:
            # A table that may be extended, such as the parts of a composite, is one setting.
            if comment or key.value in KINDS:
                yield Setting(name, "", comment)
            yield from _settings(value, lines, f"{name}.")
        else:
            yield Setting(name, _default(value, lines), comment)


def _default(value: yaml.Node, lines: list[str]) -> str:
    begin, end = value.start_mark, value.end_mark
    if begin.line == end.line:
        return lines[begin.line][begin.column : end.column]
    return " ".join(str(yaml.safe_load(yaml.serialize(value))).split())


def _comment(lines: list[str], key: yaml.Node, value: yaml.Node) -> str:
    nested = isinstance(value, yaml.CollectionNode) and not value.flow_style
    mark = key.end_mark if nested else value.end_mark
    beside = re.search(r"(?:^|\s)#\s*(.*)$", lines[mark.line][mark.column :])
    if beside:
        return beside[1]
    above: list[str] = []
    for line in reversed(lines[1 : key.start_mark.line]):
        if not line.strip().startswith("#"):
            break
        above.insert(0, line.strip().lstrip("# "))
    # A line that ends in a colon heads several settings; what stands first in a file, the file.
    at_top = not any(
        line.strip() and not line.startswith("#") for line in lines[: key.start_mark.line]
    )
    return "" if at_top or (above and above[-1].endswith(":")) else " ".join(above)


def page() -> str:
    """Return the whole reference as Markdown."""
    catalogs = {command: Catalog(command) for command in COMMANDS}
    groups = sorted({group for c in catalogs.values() for group in c.defaults} - {_EXPERIMENT})
    any_catalog = next(iter(catalogs.values()))
    parts = [_INTRODUCTION, _overview(catalogs), "## Commands"]
    parts += [_command(catalog) for catalog in catalogs.values()]
    parts += ["## Groups", *(_group(any_catalog, group, catalogs) for group in groups)]
    parts.append(_experiments(any_catalog))
    return "\n\n".join(parts) + "\n"


_INTRODUCTION = """\
# Configuration reference

Every setting of every command. This page is made from the files in `conf/` each time the
documentation is built; `tactorch COMMAND --help` shows the same in a terminal.

- A setting is given as `KEY=VALUE`, one in a group as `GROUP.KEY=VALUE`, an option of a group as
  `GROUP=OPTION`. `experiment=NAME` changes several at once.
- `???` must be given. `null` stands for nothing: not wanted, or found by the program, as the
  comment says; where it is allowed the value says "or null".
- `-m` runs all combinations of values that are divided by commas.
- `--cfg job` prints the settings of a run without running it.
"""


def _overview(catalogs: Mapping[str, Catalog]) -> str:
    rows = ["| command | what it does | groups |", "|---|---|---|"]
    for command, catalog in catalogs.items():
        about = catalog.header.splitlines()[0].partition(": ")[2].rstrip(".")
        groups = ", ".join(f"[{g}](#{g})" for g in catalog.defaults if g != _EXPERIMENT)
        rows.append(f"| [{command}](#{_anchor(command)}) | {about} | {groups} |")
    return "\n".join(rows)


def _anchor(command: str) -> str:
    return f"tactorch-{app_name(command)}"


def _command(catalog: Catalog) -> str:
    chosen = {g: o for g, o in catalog.defaults.items() if g != _EXPERIMENT}
    parts = [f"### tactorch {catalog.verb} {{#{_anchor(catalog.verb)}}}"]
    parts.append(f"```text\n{catalog.header}\n```")
    parts.append(_table(settings_of(catalog.text), ""))
    if chosen:
        links = ", ".join(f"[{group}](#{group}) = `{option}`" for group, option in chosen.items())
        parts.append(f"Groups, with what is chosen by default: {links}.")
    return "\n\n".join(parts)


def _group(catalog: Catalog, group: str, catalogs: Mapping[str, Catalog]) -> str:
    users = [f"[{c}](#{_anchor(c)})" for c, found in catalogs.items() if group in found.defaults]
    parts = [f"### {group}", f"Of {', '.join(users)}."]
    for option in catalog.options(group):
        about = catalog.about(group, option)
        parts.append(f"#### {group}={option} {{#{group}-{option}}}\n\n{html.escape(about, False)}")
        found = list(settings_of(catalog.option_text(group, option)))
        if found:
            parts.append(_table(found, f"{group}."))
    return "\n\n".join(parts)


def _experiments(catalog: Catalog) -> str:
    parts = ["### experiment", "Each changes several settings at once."]
    for option in catalog.options(_EXPERIMENT):
        text = catalog.option_text(_EXPERIMENT, option)
        lines = [line for line in text.splitlines() if not line.startswith("#")]
        about = html.escape(catalog.about(_EXPERIMENT, option), False)
        body = "\n".join(lines)
        parts.append(f"#### experiment={option}\n\n{about}\n\n```yaml\n{body}\n```")
    return "\n\n".join(parts)


def _table(found: Iterator[Setting] | list[Setting], prefix: str) -> str:
    rows = ["| setting | default | value | |", "|---|---|---|---|"]
    for setting in found:
        name = f"{prefix}{setting.name}"
        default = f"`{setting.default}`" if setting.default else ""
        cells = (f"`{name}`", default, _kind(name), html.escape(setting.comment, False))
        rows.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(rows)


def _kind(name: str) -> str:
    leaf = name.rpartition(".")[2]
    kind = KINDS.get(name, KINDS.get(leaf))
    if kind is None:
        return ""
    optional = " or null" if leaf in OPTIONAL or name in OPTIONAL else ""
    return kind.name + optional

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
from tactorch.cli.kinds import KINDS, OPTIONAL, kind_of
from tactorch.cli.main import COMMANDS

_INTERNAL = ("defaults", "hydra", "name")
_EXPERIMENT = "experiment"


@dataclass(frozen=True)
class Setting:
    """A line of a settings file.

    Attributes:
        name: Full name within the file.
        default: As it stands there.
        comment: Beside it, or on the lines above.
        heading: What a line above says of this and the following settings; empty for none.
    """

    name: str
    default: str
    comment: str
    heading: str = ""


def settings_of(text: str) -> list[Setting]:
    """Return the settings of a file, nested ones by their full names, with their comments."""
    root = yaml.compose(text)
    return list(_settings(root, text.splitlines(), "")) if root is not None else []


def _settings(node: yaml.MappingNode, lines: list[str], prefix: str) -> Iterator[Setting]:
    for key, value in node.value:
        if not prefix and key.value in _INTERNAL:
            continue
        name = f"{prefix}{key.value}"
        nested = isinstance(value, yaml.MappingNode) and not value.flow_style
        above = " ".join(_above(lines, key.start_mark.line))
        beside = _beside(lines, key if _is_block(value) else value)
        heading = above.rstrip(":") if above.endswith(":") else ""
        comment = beside or ("" if heading else above)
        if not nested:
            yield Setting(name, _default(value, lines), comment, heading)
            continue
        # A table that may be extended, such as the parts of a composite, is a setting too.
        if comment or key.value in KINDS:
            yield Setting(name, "", comment, heading)
        yield from _settings(value, lines, f"{name}.")


def _is_block(value: yaml.Node) -> bool:
    return isinstance(value, yaml.CollectionNode) and not value.flow_style


def _default(value: yaml.Node, lines: list[str]) -> str:
    begin, end = value.start_mark, value.end_mark
    if begin.line == end.line:
        return lines[begin.line][begin.column : end.column]
    content = yaml.safe_load(yaml.serialize(value))
    return yaml.safe_dump(content, default_flow_style=True, width=1000).strip()


def _beside(lines: list[str], node: yaml.Node) -> str:
    mark = node.end_mark
    found = re.search(r"(?:^|\s)#\s*(.*)$", lines[mark.line][mark.column :])
    return found[1] if found else ""


def _above(lines: list[str], line: int) -> list[str]:
    """Comments on the lines above one, but for those with which the file begins."""
    found: list[str] = []
    for text in reversed(lines[:line]):
        if not text.strip().startswith("#"):
            return found
        found.insert(0, text.strip().lstrip("# "))
    return []


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
        text = catalog.option_text(group, option)
        parts += _inherited(text, group)
        found = settings_of(text)
        if found:
            parts.append(_table(found, f"{group}."))
    return "\n\n".join(parts)


def _inherited(text: str, group: str) -> list[str]:
    """Say what an option takes over from another, and which other options it chooses."""
    chosen = []
    for entry in (yaml.safe_load(text) or {}).get("defaults", ()):
        if isinstance(entry, str) and entry != "_self_":
            return [f"As [{group}={entry}](#{group}-{entry}), but for:"]
        if isinstance(entry, dict):
            for name, option in entry.items():
                other = name.removeprefix("override /").split("@")[0]
                chosen.append(f"[{other}={option}](#{other}-{option})")
    return [f"Chooses {', '.join(chosen)} too."] if chosen else []


def _experiments(catalog: Catalog) -> str:
    parts = ["### experiment", "Each changes several settings at once."]
    for option in catalog.options(_EXPERIMENT):
        text = catalog.option_text(_EXPERIMENT, option)
        lines = [line for line in text.splitlines() if not line.startswith("#")]
        about = html.escape(catalog.about(_EXPERIMENT, option), False)
        body = "\n".join(lines)
        parts.append(f"#### experiment={option}\n\n{about}\n\n```yaml\n{body}\n```")
    return "\n\n".join(parts)


def _table(found: list[Setting], prefix: str) -> str:
    rows = ["| setting | default | value | comment |", "|---|---|---|---|"]
    for setting in found:
        name = f"{prefix}{setting.name}"
        if setting.heading:
            rows.append(f"| *{setting.heading}* | | | |")
        default = f"`{setting.default}`" if setting.default else ""
        cells = (f"`{name}`", default, _kind(name), html.escape(setting.comment, False))
        rows.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(rows)


def _kind(name: str) -> str:
    kind = kind_of(name)
    optional = name in OPTIONAL or name.split(".")[-1] in OPTIONAL
    return "" if kind is None else kind.name + (" or null" if optional else "")

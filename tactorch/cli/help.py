"""`tactorch VERB --help`: the settings with their comments, and what each option is."""

import textwrap
from collections.abc import Mapping, Sequence
from itertools import takewhile

from tactorch.cli.catalog import Catalog

_WIDTH = 98
_FOOTER = """\
-m runs every combination of values separated by commas, each in a folder of its own (0, 1, ...) in
run_dir. --cfg job prints the settings of a run without running it; --hydra-help tells more.
A path with spaces, commas, = or brackets needs quotes of its own: "path='a (1).h5'".\
"""


def help_text(verb: str, given: Sequence[str] = ()) -> str:
    """Return the help of a command; where options are `given`, their settings are shown."""
    catalog = Catalog(verb)
    choices = {g: o for g, o in catalog.choices(given).items() if o in (None, *catalog.options(g))}
    parts = [
        catalog.header,
        "Settings (KEY=VALUE), with what they are by default:",
        textwrap.indent(_body(catalog.text), "  "),
        "Groups (GROUP=OPTION); * is what you get:",
        "\n".join(_group(catalog, group, option) for group, option in choices.items()),
    ]
    if any(option is not None for option in choices.values()):
        parts += ["Settings of these options (GROUP.KEY=VALUE):", _chosen(catalog, choices)]
    return "\n\n".join((*parts, _FOOTER))


def _body(text: str) -> str:
    """The settings in a file as they stand there, without defaults list and Hydra's own."""
    kept: list[str] = []
    keep = False
    for line in text.splitlines():
        if line and not line[0].isspace():
            keep = not line.startswith(("#", "defaults:", "hydra:", "name:"))
        if keep and line:
            kept.append(line)
    return "\n".join(kept)


def _group(catalog: Catalog, group: str, chosen: str | None) -> str:
    options = catalog.options(group)
    width = max(len(option) for option in options)
    lines = [f"  {group}"]
    for option in options:
        head = f"  {'*' if option == chosen else ' '} {option:<{width}}  "
        about = textwrap.wrap(catalog.about(group, option), _WIDTH - len(head)) or [""]
        lines += [(head + about[0]).rstrip()]
        lines += [" " * len(head) + more for more in about[1:]]
    return "\n".join(lines)


def _chosen(catalog: Catalog, choices: Mapping[str, str | None]) -> str:
    found = []
    for group, option in choices.items():
        body = "" if option is None else _body(catalog.option_text(group, option))
        if body and group != "experiment":
            found.append(f"  {group}: ({option})\n{textwrap.indent(body, '    ')}")
    return "\n".join(found)


def wants_help(settings: Sequence[str]) -> bool:
    """Say whether help is asked for."""
    flags = takewhile(lambda word: word != "--", settings)
    return any(flag in ("-h", "--help") for flag in flags)

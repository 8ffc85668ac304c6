"""Presets and experiments: YAML files of settings that differ from the typed defaults.

They come with tactorch, or from a folder of the user (`--config-dir`). The latter are read as plain
settings: nothing in them reaches Hydra's own settings, by which a file could run any function.
"""

import importlib.util
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import takewhile
from pathlib import Path
from typing import Any

from tactorch.budget import check_references
from tactorch.config.targets import TARGET
from tactorch.config.values import leaves
from tactorch.errors import ConfigError, FileError
from tactorch.files import read_yaml

PACKAGE = "tactorch.conf"
EXPERIMENT = "experiment"
#: Text that runs a function or reads the environment when settings are resolved; ${NAME}, the time
#: and the settings of Hydra do not.
PROGRAM = re.compile(r"_target_|\$\{(?!now:|hydra:|[\w.]+\})")
_HYDRA = re.compile(r"(override )?/*hydra([/.@]|\Z)")
_OVERRIDE = "override /"

#: A setting as plain values, with the keys of `tactorch.cli.schema.describe_settings`.
Entry = dict[str, Any]


def conf_folder() -> Path:
    """Return the folder of presets and experiments: in the package, or beside it in a checkout."""
    spec = importlib.util.find_spec(PACKAGE)
    places = [] if spec is None else [Path(p) for p in spec.submodule_search_locations or ()]
    for place in (*places, Path(__file__).resolve().parents[2] / "conf"):
        if (place / EXPERIMENT).is_dir():
            return place
    raise FileError(f"the presets ({PACKAGE}) are not installed; reinstall tactorch.")


def add_presets(
    folder: Path, group: dict[str, Any], component: Callable[[str], Entry] | None = None
) -> None:
    """Add the presets in a folder to the options of a group.

    `component` describes an option of the group, which may have to be imported for it.

    A preset names a component (`name`), or inherits from another option, or changes the settings of
    a group that has one class; what it leaves out has the typed defaults.
    """
    for path in sorted(folder.glob("*.yaml")):
        _add_preset(path, group, component or group["options"].__getitem__)


def _add_preset(path: Path, group: dict[str, Any], describe: Callable[[str], Entry]) -> None:
    values, options = read_table(path), group["options"]
    values.pop(TARGET, None)  # an option already, of the name of the file
    inherited, overrides = _read_defaults(values.pop("defaults", ()), path)
    component = inherited
    if group["settings"] is None and not inherited:
        component = str(values.pop("name", path.stem))
    if inherited and inherited not in options:
        _add_preset(path.with_name(f"{inherited}.yaml"), group, describe)
    if component and component not in options:
        raise ConfigError(
            f"'{path}': name={component} is unknown; choose one of {', '.join(options)}."
        )
    base = describe(component) if component else {"component": "", "help": ""}
    if "error" in base:
        raise ConfigError(f"'{path}': {base['error']}")
    settings = base.get("settings", group["settings"])
    names = {entry["name"] for entry in settings}
    changed = dict(leaves(values, names))
    unknown = next((name for name in changed if name not in names), None)
    if unknown is not None:
        raise ConfigError(f"'{path}' has the unknown setting '{unknown}'; remove it.")
    options[path.stem] = {
        "component": base["component"],
        "help": _leading_comment(path) or base["help"],
        "settings": [{**s, "default": changed.get(s["name"], s["default"])} for s in settings],
        "overrides": overrides,
    }


def _read_defaults(entries: Sequence[Any], path: Path) -> tuple[str, dict[str, str]]:
    """Return the option that a defaults list inherits from, and what it chooses elsewhere."""
    inherited, overrides = "", {}
    for entry in entries:
        names = [str(name) for name in entry] if isinstance(entry, Mapping) else []
        if isinstance(entry, str) and "/" not in entry and not inherited:
            inherited = "" if entry == "_self_" else entry
        elif entry != "_self_" and not (names and all(n.startswith(_OVERRIDE) for n in names)):
            raise ConfigError(
                f"'{path}': defaults: {entry!r} is neither an option of the same group nor an entry"
                f" '{_OVERRIDE}GROUP: OPTION'; change it."
            )
        for name in names:
            overrides[name.removeprefix(_OVERRIDE).partition("@")[0]] = entry[name]
    return inherited, overrides


def read_experiments(
    folder: Path, settings: Sequence[Entry], groups: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the experiments in a folder all of whose settings a command has."""
    tops = {entry["name"].split(".")[0] for entry in settings} | set(groups)
    experiments = {}
    for path in sorted((folder / EXPERIMENT).glob("*.yaml")):
        values = read_table(path)
        _, overrides = _read_defaults(values.pop("defaults", ()), path)
        if {*values, *overrides} <= tops:
            text = _leading_comment(path)
            experiments[path.stem] = {"help": text, "values": values, "overrides": overrides}
    return experiments


def _leading_comment(path: Path) -> str:
    """Return the comment lines of a file that stand before its first setting."""
    lines = path.read_text(encoding="utf-8").splitlines()
    comment = takewhile(lambda line: line.startswith("#"), lines)
    return " ".join(line.lstrip("# ") for line in comment if not line.startswith("# @package"))


def check_plain(folder: Path) -> None:
    """Refuse settings of Hydra and names of functions in the files of a folder."""
    settings: list[str] = []
    for path in sorted(folder.rglob("*.yaml")):
        is_hydra = path.relative_to(folder).parts[0] == "hydra"
        is_hydra = is_hydra or b"@package hydra" in path.read_bytes()
        values = read_table(path)
        if path.parent.parent == folder:  # an option of a group, whose package has to be trusted
            values.pop(TARGET, None)
        programs = list(_programs(values))
        if is_hydra or programs:
            raise ConfigError(
                f"'{path}' sets '{programs[0] if programs else 'hydra'}', which can run programs "
                "or read the environment; remove it, or add --trust-config-dir if you trust "
                "everything in that folder."
            )
        settings += [f"{name}={value}" for name, value in leaves(values)]
    check_references(folder, settings)


def _programs(value: Any, is_name: bool = False) -> Iterator[str]:
    """Yield the names of Hydra's settings in a table, and text that runs a function."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _programs(str(key), is_name=True)
            yield from _programs(inner, is_name=key == "defaults")
    elif isinstance(value, list):
        for item in value:
            yield from _programs(item, is_name)
    elif isinstance(value, str) and (PROGRAM.search(value) or (is_name and _HYDRA.match(value))):
        yield value


def read_table(path: Path) -> dict[str, Any]:
    """Return the table in a YAML file."""
    content = read_yaml(path, f"'{path}'", ConfigError)
    if not isinstance(content, dict | None):
        raise ConfigError(f"'{path}' does not hold a table of settings; write KEY: VALUE lines.")
    return {str(key): value for key, value in (content or {}).items()}

"""Settings, groups, options and experiments of a command.

They are read from the command's options class, from the components that its groups can choose, and
from the presets and experiments in `conf/`. The result is stored in the cache folder: importing all
components takes seconds, and help and completion must not.
"""

import importlib
import importlib.util
import inspect
import json
import os
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from typing import Any, get_type_hints

from tactorch.errors import ConfigError, FileError
from tactorch.files import atomic_path, cache_folder

PACKAGE = "tactorch.conf"
EXPERIMENT = "experiment"
#: Commands whose module has another name.
_MODULES = {"import": "import_", "evaluate-model": "evaluate_model"}
_OVERRIDE = "override /"

Entry = dict[str, Any]


def conf_folder() -> Path:
    """Return the folder of presets and experiments: in the package, or beside it in a checkout.

    Raises:
        FileError: they are in neither place.
    """
    spec = importlib.util.find_spec(PACKAGE)
    places = [] if spec is None else [Path(p) for p in spec.submodule_search_locations or ()]
    for place in (*places, Path(__file__).resolve().parents[2] / "conf"):
        if (place / EXPERIMENT).is_dir():
            return place
    raise FileError(f"the presets ({PACKAGE}) are not installed; reinstall tactorch.")


def app_name(command: str) -> str:
    """Return a command's name without a space, for Hydra and for folders."""
    return command.replace(" ", "-")


def command_module(command: str) -> Any:
    """Import the module of a command."""
    return importlib.import_module(
        f"tactorch.cli.{_MODULES.get(command, command).replace(' ', '.')}"
    )


def options_class(command: str) -> type:
    """Return the options class of a command: the type of the argument of its `run`."""
    run = command_module(command).run
    options: type = get_type_hints(run)[next(iter(inspect.signature(run).parameters))]
    return options


class Schema:
    """Settings and groups of one command.

    Attributes:
        command: Name of the command.
        header: What the command does, with examples.
        settings: Settings that belong to no group.
        groups: Default and options of each group.
        experiments: Experiments that apply to the command.
    """

    def __init__(self, content: Mapping[str, Any]) -> None:
        self.command: str = content["command"]
        self.header: str = content["header"]
        self.settings: list[Entry] = content["settings"]
        self.groups: dict[str, Any] = content["groups"]
        self.experiments: dict[str, Any] = content["experiments"]

    @property
    def defaults(self) -> dict[str, str | None]:
        """The option of each group that is chosen by default."""
        chosen = {group: found["default"] for group, found in self.groups.items()}
        return {**chosen, EXPERIMENT: None}

    def options(self, group: str) -> dict[str, Any]:
        """Return the options of a group, or the experiments, by name."""
        found = self.experiments if group == EXPERIMENT else self.groups[group]["options"]
        return dict(found)

    def option_settings(self, group: str, option: str | None) -> list[Entry]:
        """Return the settings of an option; none of the user's own options."""
        found = self.groups[group]["options"].get(option) if group in self.groups else None
        return [] if found is None else list(found["settings"])

    def choices(self, words: Sequence[str]) -> dict[str, str | None]:
        """Return the option of each group once the words (GROUP=OPTION among them) are applied."""
        pairs = (word.lstrip("+").partition("=") for word in words)
        return self.resolve({key: value for key, _, value in pairs if key in self.defaults})

    def resolve(self, given: Mapping[str, str]) -> dict[str, str | None]:
        """Return the option of each group, where options choose those of other groups."""
        chosen = dict(self.defaults)
        for group in (*self.groups, EXPERIMENT):
            option = given.get(group)
            if option in self.options(group):
                chosen |= self.options(group)[option]["overrides"]
        return chosen | dict(given)

    def entries(self, choices: Mapping[str, str | None]) -> dict[str, Entry]:
        """Return every setting by its full name, such as "optimizer.tolerance"."""
        found = {entry["name"]: entry for entry in self.settings}
        for group, option in choices.items():
            for entry in self.option_settings(group, option):
                found[f"{group}.{entry['name']}"] = entry
        return found


def load_schema(command: str) -> Schema:
    """Return the schema of a command, from the cache where it is up to date."""
    path = cache_folder() / "schema" / f"{app_name(command)}-{_code_key()}.json"
    with suppress(OSError, ValueError, KeyError):
        content = json.loads(path.read_text(encoding="utf-8"))
        if all(_file_key(file) == key.encode() for file, key in content["extensions"].items()):
            return Schema(content)
    content = {**describe_command(command), "extensions": _extension_keys()}
    with suppress(FileError, OSError):
        for outdated in path.parent.glob(f"{app_name(command)}-*.json"):
            if len(outdated.name) == len(path.name):
                outdated.unlink(missing_ok=True)
        with atomic_path(path) as temporary:
            temporary.write_text(json.dumps(content), encoding="utf-8")
    return Schema(content)


def _code_key() -> str:
    """Return a digest that changes with the code, the presets and the installed packages."""
    package = Path(__file__).resolve().parents[1]
    digest = sha256(sys.version.encode())
    for root in (package, conf_folder()):
        for folder, folders, files in os.walk(root):
            folders[:] = sorted(f for f in folders if f not in ("__pycache__", "shells"))
            for name in sorted(files):
                if name.endswith((".py", ".yaml")):
                    digest.update(_file_key(os.path.join(folder, name)))
    for place in sys.path:  # an installed package may add components by entry points
        with suppress(OSError):
            for name in sorted(n for n in os.listdir(place or ".") if n.endswith(".dist-info")):
                digest.update(_file_key(os.path.join(place, name)))
    return digest.hexdigest()[:16]


def _extension_keys() -> dict[str, str]:
    """Return the key of each file that declares a component of another package."""
    from tactorch.config import REGISTRIES

    modules = {path.partition(":")[0] for r in REGISTRIES.values() for path in r.extensions()}
    loaded = (getattr(sys.modules.get(module), "__file__", None) for module in modules)
    return {file: _file_key(file).decode() for file in loaded if file}


def _file_key(path: str) -> bytes:
    status = os.stat(path)
    return f"{path} {status.st_mtime_ns} {status.st_size};".encode()


# ------------------------------------------------------------------ describing


def describe_command(command: str) -> dict[str, Any]:
    """Return the schema of a command as plain values; imports all its components."""
    from tactorch.config import settings_of
    from tactorch.config.schema import describe_settings

    options = options_class(command)
    settings: list[Entry] = []
    groups: dict[str, Any] = {}
    ordered = sorted(settings_of(options), key=lambda s: _order(s, options))
    for setting in ordered:
        if _is_group(setting):
            groups[setting.name] = _describe_group(setting)
        elif setting.nested is not None:
            settings += describe_settings(setting.nested, f"{setting.name}.")
        else:
            settings += [e for e in describe_settings(options) if e["name"] == setting.name]
    for entry in settings:
        if isinstance(entry["default"], str):
            entry["default"] = entry["default"].replace("${hydra:job.name}", app_name(command))
    # Options that choose those of other groups come after them, as Hydra wants it.
    names = sorted(groups, key=lambda g: any(o["overrides"] for o in groups[g]["options"].values()))
    return {
        "command": command,
        "header": (command_module(command).__doc__ or "").replace("`", "").rstrip(),
        "settings": settings,
        "groups": {group: groups[group] for group in names},
        "experiments": read_experiments(conf_folder(), settings, groups),
    }


def _order(setting: Any, options: type) -> tuple[bool, int]:
    """Sort required settings first, from the bases; of the others, a command's own come first."""
    classes = options.__mro__
    rank = next(i for i, c in enumerate(classes) if setting.name in inspect.get_annotations(c))
    return (not setting.required, -rank if setting.required else rank)


def _is_group(setting: Any) -> bool:
    from tactorch.config import REGISTRIES

    return setting.constraint.section in REGISTRIES or bool(setting.constraint.preset)


def _describe_group(setting: Any) -> dict[str, Any]:
    from tactorch.config import REGISTRIES
    from tactorch.config.schema import default_of, describe_settings

    registry = REGISTRIES.get(setting.constraint.section)
    group: dict[str, Any] = {"help": setting.constraint.help, "settings": None}
    if registry is None:
        group["settings"], group["options"] = list(describe_settings(setting.nested)), {}
    else:
        group["options"] = {name: _describe_component(registry, name) for name in registry.names()}
    group["default"] = setting.constraint.preset or default_of(setting)
    add_presets(conf_folder() / setting.name, group)
    return group


def _describe_component(registry: Any, name: str) -> dict[str, Any]:
    from tactorch.config.schema import describe_settings, summary_of

    found: dict[str, Any] = {"component": name, "settings": [], "overrides": {}}
    try:
        component = registry[name]
    except ConfigError as error:  # of another package; choosing it says the same
        return {**found, "help": str(error)}
    return {
        **found,
        "help": summary_of(component),
        "settings": list(describe_settings(component)),
    }


# ------------------------------------------------------------------ presets and experiments


def add_presets(folder: Path, group: dict[str, Any]) -> None:
    """Add the presets in a folder to the options of a group.

    A preset names a component (`name`), or inherits from another option, or changes the settings of
    a group that has one class; what it leaves out has the typed defaults.

    Raises:
        ConfigError: a preset cannot be read, or has an unknown setting.
    """
    for path in sorted(folder.glob("*.yaml")):
        _add_preset(path, group)


def _add_preset(path: Path, group: dict[str, Any]) -> None:
    from tactorch.config.schema import with_values

    values, options = read_yaml(path), group["options"]
    inherited, overrides = _read_defaults(values.pop("defaults", ()), path)
    component = inherited
    if group["settings"] is None and not inherited:
        component = str(values.pop("name", path.stem))
    if inherited and inherited not in options:
        _add_preset(path.with_name(f"{inherited}.yaml"), group)
    if component and component not in options:
        raise ConfigError(
            f"'{path}': name={component} is unknown; choose one of {', '.join(options)}."
        )
    base = options[component] if component else {"component": "", "help": ""}
    options[path.stem] = {
        "component": base["component"],
        "help": _leading_comment(path) or base["help"],
        "settings": with_values(base.get("settings", group["settings"]), values, str(path)),
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
    found = {}
    for path in sorted((folder / EXPERIMENT).glob("*.yaml")):
        values = read_yaml(path)
        _, overrides = _read_defaults(values.pop("defaults", ()), path)
        if {*values, *overrides} <= tops:
            about = _leading_comment(path)
            found[path.stem] = {"help": about, "values": values, "overrides": overrides}
    return found


def _leading_comment(path: Path) -> str:
    """Return the comment lines of a file that stand before its first setting."""
    lines = []
    for line in path.read_text(encoding="utf-8").splitlines():
        if line.startswith("# @package"):
            continue
        if not line.startswith("#"):
            break
        lines.append(line.lstrip("# "))
    return " ".join(lines)


def read_yaml(path: Path) -> dict[str, Any]:
    """Return the table in a YAML file.

    Raises:
        ConfigError: it is no table of settings.
    """
    import yaml

    try:
        content = yaml.load(path.read_bytes(), getattr(yaml, "CSafeLoader", yaml.SafeLoader))
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as error:
        reason = " ".join(str(error).split())
        raise ConfigError(f"'{path}' cannot be read ({reason}); repair it.") from error
    if not isinstance(content, dict | None):
        raise ConfigError(f"'{path}' does not hold a table of settings; write KEY: VALUE lines.")
    return {str(key): value for key, value in (content or {}).items()}

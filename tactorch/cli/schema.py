"""Settings, groups, options and experiments of a command.

They are read from the command's options class, from the components that its groups can choose, and
from the presets and experiments in `conf/`. The result is stored in the cache folder: importing all
components takes seconds, and help and completion must not. Components of other packages are not in
it: each is imported where it is chosen.
"""

import inspect
import json
import os
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from importlib import import_module
from keyword import iskeyword
from pathlib import Path
from typing import Any, get_type_hints

from tactorch.cli import presets
from tactorch.cli.presets import EXPERIMENT, Entry, conf_folder
from tactorch.config import REGISTRIES, Options, Registry, Setting, settings_of, to_mapping
from tactorch.config.registry import NO_VALUE
from tactorch.config.targets import TARGET, load_target
from tactorch.config.values import leaf_types
from tactorch.errors import ConfigError, FileError
from tactorch.files import cache_folder, require_folder, write_file


def app_name(command: str) -> str:
    """Return a command's name without a space, for Hydra and for folders."""
    return command.replace(" ", "-")


def command_module(command: str) -> Any:
    """Import the module of a command."""
    name = command.replace("-", "_").replace(" ", ".")
    return import_module(f"tactorch.cli.{name}{'_' if iskeyword(name) else ''}")


def options_class(command: str) -> type[Options]:
    """Return the options class of a command: the type of the argument of its `run`."""
    run = command_module(command).run
    options: type[Options] = get_type_hints(run)[next(iter(inspect.signature(run).parameters))]
    return options


#: Key of an option of another package that is not imported yet.
_PACKAGE = "package"


@dataclass
class Schema:
    """Settings and groups of one command."""

    command: str
    header: str  # purpose of the command, with examples
    settings: list[Entry]  # those that belong to no group
    groups: dict[str, Any]  # default and options of each group
    experiments: dict[str, Any]  # those that apply to the command

    @property
    def defaults(self) -> dict[str, str | None]:
        """The option of each group that is chosen by default."""
        return {**{name: group["default"] for name, group in self.groups.items()}, EXPERIMENT: None}

    def options(self, group: str) -> dict[str, Any]:
        """Return the options of a group, or the experiments, by name."""
        return dict(self.experiments if group == EXPERIMENT else self.groups[group]["options"])

    def component(self, group: str, option: str | None) -> dict[str, Any]:
        """Return what is known of an option; that of another package is imported for it.

        An experiment or an unknown option has no settings.
        """
        options = self.groups[group]["options"] if group in self.groups else {}
        described = options.get(option, {"settings": []})
        if described.pop(_PACKAGE, None):
            options_class(self.command)  # imports the registries
            described |= describe_plugin(REGISTRIES[group], described["component"])
        return described

    def check(self, choices: Mapping[str, str | None]) -> None:
        """Refuse the choice of a component of another package that cannot be loaded."""
        for group, option in choices.items():
            if error := self.component(group, option).get("error"):
                raise ConfigError(error)

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
        entries = {entry["name"]: entry for entry in self.settings}
        for group, option in choices.items():
            for entry in self.component(group, option)["settings"]:
                entries[f"{group}.{entry['name']}"] = entry
        return entries

    def add_folder(self, folder: Path) -> None:
        """Add the presets and experiments of a folder of the user."""
        presets.check_plain(require_folder(folder, "folder of settings (--config-dir)"))
        for group in (*self.groups, EXPERIMENT):
            for path in (folder / group).glob("*.yaml"):
                if path.stem in self.options(group):
                    raise ConfigError(f"'{path}' has the name of an option of tactorch; rename it.")
        for path in sorted(folder.glob("*/*.yaml")):
            if TARGET in (values := presets.read_table(path)):
                described = _describe_target(self.command, path, values[TARGET])
                # Other commands read the settings of runs that have it.
                if path.parent.name in self.groups:
                    self.groups[path.parent.name]["options"][path.stem] = described
        for name, group in self.groups.items():
            presets.add_presets(folder / name, group, partial(self.component, name))
        self.experiments |= presets.read_experiments(folder, self.settings, self.groups)


def load_schema(command: str) -> Schema:
    """Return the schema of a command, from the cache where it is up to date."""
    path = cache_folder() / "schema" / f"{app_name(command)}-{_code_key()}.json"
    with suppress(OSError, ValueError, KeyError):
        content = json.loads(path.read_text(encoding="utf-8"))
        return Schema(**content)
    content = describe_command(command)
    with suppress(FileError, OSError):
        for outdated in path.parent.glob(f"{app_name(command)}-*.json"):
            if len(outdated.name) == len(path.name):
                outdated.unlink(missing_ok=True)
        write_file(path, json.dumps(content))
    return Schema(**content)


def _code_key() -> str:
    """Return a digest that changes with the code, the presets and the installed packages."""
    keys = [sys.version]
    for root in (Path(__file__).resolve().parents[1], conf_folder()):
        for folder, folders, files in os.walk(root):
            folders[:] = sorted(f for f in folders if f not in ("__pycache__", "shells"))
            names = sorted(name for name in files if name.endswith((".py", ".yaml")))
            keys += [_file_key(os.path.join(folder, name)) for name in names]
    for place in sys.path:  # an installed package may add components by entry points
        with suppress(OSError):
            names = sorted(n for n in os.listdir(place or ".") if n.endswith(".dist-info"))
            keys += [_file_key(os.path.join(place, name)) for name in names]
            tables = [os.path.join(place, name, "entry_points.txt") for name in names]
            keys += [_file_key(table) for table in tables if os.path.isfile(table)]
    return sha256("".join(keys).encode()).hexdigest()[:16]


def _file_key(path: str) -> str:
    status = os.stat(path)
    return f"{path} {status.st_mtime_ns} {status.st_size};"


def describe_command(command: str) -> dict[str, Any]:
    """Return the fields of a command's schema as plain values.

    All its components are imported, except those of other packages.
    """
    options = options_class(command)
    settings: list[Entry] = []
    groups: dict[str, Any] = {}
    for setting in sorted(settings_of(options), key=lambda s: _order(s, options)):
        if setting.registry is not None or setting.preset:
            groups[setting.name] = _describe_group(setting)
        else:
            settings += _describe(setting)
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
        "experiments": presets.read_experiments(conf_folder(), settings, groups),
    }


def _order(setting: Setting, options: type) -> tuple[bool, int]:
    """Sort required settings first, from the bases; of the others, a command's own come first."""
    classes = options.__mro__
    rank = next(i for i, c in enumerate(classes) if setting.name in inspect.get_annotations(c))
    return (not setting.required, -rank if setting.required else rank)


def _describe_group(setting: Setting) -> dict[str, Any]:
    registry = setting.registry
    group: dict[str, Any] = {"help": setting.help, "settings": None, "options": {}}
    if registry is not None:
        plugins = registry.plugins()
        options = {n: _describe_component(registry, n) for n in registry if n not in plugins}
        options |= {
            n: {"component": n, "overrides": {}, "help": f"Of the package {p}", "settings": []}
            | {_PACKAGE: True}
            for n, p in plugins.items()
        }
        group["options"] = options
    elif setting.nested is not None:
        group["settings"] = describe_settings(setting.nested)
    group["default"] = setting.preset or _default(setting)
    presets.add_presets(conf_folder() / setting.name, group)
    return group


def _describe_target(command: str, path: Path, target: Any) -> dict[str, Any]:
    """Register a component of a user-defined module under the name of its file, and describe it."""
    group = path.parent.name
    options_class(command)  # imports the registries, which a stored schema does not need
    if group not in REGISTRIES:
        raise ConfigError(f"'{path}': {group} has no components; remove {TARGET}.")
    registry = REGISTRIES[group]
    component = load_target(target, registry, str(path))
    if path.stem not in registry:
        registry.register(path.stem, component)
    elif registry[path.stem] is not component:
        raise ConfigError(f"'{path}': {group} '{path.stem}' exists; rename the file.")
    return _describe_component(registry, path.stem)


def _describe_component(registry: Registry, name: str) -> dict[str, Any]:
    component = registry[name]
    text = (inspect.getdoc(component) or "").partition("\n\n")[0].replace("\n", " ").strip()
    settings = describe_settings(component)
    return {"component": name, "overrides": {}, "help": text, "settings": settings}


def describe_plugin(registry: Registry, name: str) -> dict[str, Any]:
    """Describe a component of another package, or why it cannot be used."""
    try:
        return _describe_component(registry, name)
    except ConfigError as error:
        return {"help": str(error), "error": str(error)}
    except Exception as error:  # of its settings, whatever they are
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        text = f"{registry.section} '{name}' of {registry.plugins()[name]} has settings that"
        text += f" cannot be read ({reason}); repair or uninstall that package."
        return {"help": text, "error": text}


def describe_settings(options: type, prefix: str = "") -> list[Entry]:
    """Return the settings of a class as plain values, nested ones by their full names."""
    return [entry for setting in settings_of(options) for entry in _describe(setting, prefix)]


def _describe(setting: Setting, prefix: str = "") -> list[Entry]:
    registry = setting.registry
    if setting.nested is not None and registry is None:
        return describe_settings(setting.nested, f"{prefix}{setting.name}.")
    types, default = leaf_types(setting.annotation), _default(setting)
    names = setting.choices if registry is None else registry.names()
    # A component with settings is a table: its name alone is no value.
    builtin = () if registry is None else registry.builtin()
    is_component = registry is not None and any(settings_of(registry[n]) for n in builtin)
    entry = {
        "name": f"{prefix}{setting.name}",
        "default": {"name": default} if is_component else default,
        "help": setting.help,
        "unit": setting.unit,
        "range": setting.range,
        "expectation": setting.expectation if registry is None else " or ".join(names),
        "choices": [text_of(name) for name in names],
        "is_path": Path in types,
        "is_table": dict in types or is_component,
    }
    return [entry]


def _default(setting: Setting) -> Any:
    """Return the default as a plain value: a component by its name, "???" where there is none."""
    if setting.registry is not None and isinstance(setting.default, Options):
        return setting.registry.name_of(type(setting.default))
    return NO_VALUE if setting.required else to_mapping(setting.default)


def text_of(value: Any) -> str:
    """Return a plain value as it is written in YAML and on the command line."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(text_of, value))}]"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key}: {text_of(v)}" for key, v in value.items()) + "}"
    return str(value)

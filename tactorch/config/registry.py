"""Named components of a kind, built in or from installed packages."""

import difflib
import inspect
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import redirect_stdout, suppress
from functools import cache
from importlib import import_module, metadata
from typing import Any

from tactorch.errors import ConfigError

#: Start of the names of groups of entry points; the section follows.
GROUPS = "tactorch."
#: Text of a required value in a configuration file.
NO_VALUE = "???"
#: All registries by section, in the order in which they were made.
REGISTRIES: dict[str, "Registry"] = {}


class Registry:
    """Components of one kind by name; they are imported when they are first chosen.

    An installed package adds its own by an entry point of the group `tactorch.SECTION`:

        [project.entry-points."tactorch.regularization"]
        my_prior = "my_package.my_module:MyPrior"

    Args:
        section: Name of the kind, and of the settings' group, such as "regularization".
        builtin: Import path "module:attribute" of each built-in component.
    """

    def __init__(self, section: str, builtin: Mapping[str, str]) -> None:
        self.section = section
        self._paths = dict(builtin)
        self._added: dict[str, Any] = {}
        REGISTRIES[section] = self

    def names(self) -> tuple[str, ...]:
        """Return all names: built-in ones in their order, then those of other packages."""
        others = sorted({*self._plugins(), *self._added} - set(self._paths))
        return (*self._paths, *others)

    def builtin(self) -> tuple[str, ...]:
        """Return the names of the components of tactorch."""
        return tuple(self._paths)

    def plugins(self) -> dict[str, str]:
        """Return what each component of an installed package is, without importing it."""
        found = self._plugins().items()
        return {name: origin(entry) for name, entry in found if name not in self._paths}

    def base(self) -> Any:
        """Return the class of settings that components derive from; None if they are functions."""
        classes = [c for c in map(self.__getitem__, self._paths) if inspect.isclass(c)]
        if not classes:
            return None
        common = next(b for b in classes[0].__mro__ if all(b in c.__mro__ for c in classes))
        return common if hasattr(common, "from_mapping") else None

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names."""
        return iter(self.names())

    def __contains__(self, name: object) -> bool:
        """Return whether there is a component of this name."""
        return name in self.names()

    def register(self, name: str, component: Any) -> Any:
        """Add a component for this process under a name that is free, and return it."""
        if name in self:
            raise ConfigError(f"{self.section} '{name}' exists; give the component another name.")
        self._added[name] = component
        return component

    def __getitem__(self, name: str) -> Any:
        """Import and return a component."""
        if name in self._paths:
            module, _, attribute = self._paths[name].partition(":")
            return getattr(import_module(module), attribute)
        if name in self._added:
            return self._added[name]
        plugins = self._plugins()
        if name not in plugins:
            raise ConfigError(unknown_choice(self.section, name, self.names()))
        return self._load(name, plugins[name])

    def _load(self, name: str, entry: Any) -> Any:
        """Import a component of another package, which may raise, print or end the process."""
        try:
            with redirect_stdout(sys.stderr):
                component = entry.load()
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # SystemExit, and exceptions that derive from none other
            reason = " ".join(f"{type(error).__name__}: {error}".split())
            raise ConfigError(
                f"{self.section} '{name}' of the entry point {entry.value} cannot be "
                f"loaded ({reason}); repair or uninstall that package. Its distribution is "
                f"{package(entry)}."
            ) from error
        base = self.base()
        if base and not (inspect.isclass(component) and issubclass(component, base)):
            raise ConfigError(
                f"{self.section} '{name}': {entry.value} is no {base.__name__.lower()}; derive the "
                f"class from {base.__module__}.{base.__qualname__}, or uninstall that package. Its "
                f"distribution is {package(entry)}."
            )
        return component

    def name_of(self, component: type) -> str:
        """Return the name of a component class, or its import path where it has no name."""
        paths = self._paths | {name: entry.value for name, entry in self._plugins().items()}
        for name, path in paths.items():
            module, _, attribute = path.partition(":")
            if getattr(sys.modules.get(module), attribute, None) is component:
                return name
        added = (name for name, value in self._added.items() if value is component)
        return next(added, f"{component.__module__}:{component.__qualname__}")

    def build(self, given: Any, section: str = "") -> Any:
        """Make the settings of a component.

        Args:
            given: A name, a table with the key "name" and other settings, or an object made
                already, which is returned as it is.
            section: Section of the settings, for messages; that of the registry by default.

        Returns:
            Settings of the component, an object of its class.

        Raises:
            ConfigError: the name or a setting is unknown, or a value cannot be used.
        """
        if isinstance(given, str):
            given = {"name": given}
        if not isinstance(given, Mapping):
            return given
        values, section = dict(given), section or self.section
        name = values.pop("name", None)
        if name is None and "_target_" in values:
            raise ConfigError(
                f"{section} has _target_: {values['_target_']} and no name; give the folder of "
                "settings with --trust PACKAGE instead of --trust-config-dir, or the object itself "
                "in Python."
            )
        if not isinstance(name, str):
            names = ", ".join(self.names())
            raise ConfigError(f"{section}.name={name!r}: choose one of {names}.")
        if name not in self:
            raise ConfigError(unknown_choice(section, name, self.names()))
        return self[name].from_mapping(values, section, f"{section}={name}")

    def _plugins(self) -> dict[str, Any]:
        group = f"{GROUPS}{self.section}"
        return {entry.name: entry for entry in entry_points() if entry.group == group}


@cache
def entry_points() -> tuple[Any, ...]:
    """Return those for tactorch, by group, as the process finds them first; none is imported.

    Raises:
        ConfigError: The list of a distribution is damaged.
    """
    found: dict[str, list[Any]] = {}
    for distribution in metadata.distributions():
        try:
            name = getattr(distribution, "_normalized_name", None) or _name(distribution)
            if name in found:  # the first of a name counts
                continue
            entries = [e for e in distribution.entry_points if e.group.startswith(GROUPS)]
        except Exception as error:  # whatever a damaged list leads to
            raise ConfigError(
                f"entry_points.txt of the package {_name(distribution)} cannot be read ({error}); "
                "reinstall or uninstall it, as other packages fail by it too."
            ) from error
        found[str(name)] = entries
    every = [entry for entries in found.values() for entry in entries]
    return tuple(sorted(every, key=lambda entry: entry.group))


def _name(distribution: Any) -> str:
    """Return the name of a distribution; where it is if it has none, or damaged metadata."""
    with suppress(Exception):
        if name := distribution.metadata["Name"]:
            return str(name)
    place = getattr(distribution, "_path", None) or distribution.locate_file("")
    return f"without a name in '{place}'"


def package(entry: Any) -> str:
    """Return the name of the distribution of an entry point."""
    return _name(entry.dist) if entry.dist is not None else "unknown"


def origin(entry: Any) -> str:
    """Return distribution and import path of an entry point."""
    return f"{package(entry)} ({entry.value})"


def missing_setting(name: str, expectation: str) -> str:
    """Return the message for a setting without a value."""
    return f"'{name}' is missing; give {name}=... ({expectation})."


def unknown_choice(section: str, name: str, names: Iterable[str]) -> str:
    """Return the message for a name that a registry does not have."""
    names = tuple(names)
    hint = did_you_mean(name, names)
    return f"{section}={name} is unknown; choose one of {', '.join(names)}.{hint}"


_SAME_NAME = 0.85  # similarity of a full name whose group is misspelt


def unknown_setting(name: str, known: Iterable[str], prefix: str = "", chosen: str = "") -> str:
    """Return the message for a setting that does not exist, with the name that is likely meant.

    `known` are full names. Without a similar one, those that begin with `prefix` are listed as the
    settings of what is `chosen`, if anything is.
    """
    known, (group, dot, leaf) = tuple(known), name.rpartition(".")
    inside = [other for other in known if dot and other.startswith(f"{group}.")]
    if dot and not inside and (match := difflib.get_close_matches(name, known, 1, _SAME_NAME)):
        return f"unknown setting '{name}'. Did you mean '{match[0]}'?"
    # The last part of a name counts: in a group all names begin alike.
    leaf_names = {other.rpartition(".")[2]: other for other in reversed(inside or known)}
    match = difflib.get_close_matches(leaf, leaf_names, n=1, cutoff=0.6 if inside else 0.75)
    if match:
        return f"unknown setting '{name}'. Did you mean '{leaf_names[match[0]]}'?"
    listed = ", ".join(k.removeprefix(prefix) for k in known if k.startswith(prefix)) or "none"
    return f"unknown setting '{name}'." + (f" Settings of {chosen}: {listed}." if chosen else "")


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return a question that suggests the closest name, or nothing."""
    lowered = {name.lower(): name for name in known}
    match = difflib.get_close_matches(word.lower(), lowered, n=1)
    return f" Did you mean '{lowered[match[0]]}'?" if match else ""

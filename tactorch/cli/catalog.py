"""The settings that exist: what the files under conf/ say, comments included."""

import importlib.util
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

from tactorch.errors import FileError

PACKAGE = "tactorch.conf"


def conf_folder() -> Path:
    """Return where the settings are: in the package, or beside it in a bare checkout.

    Raises:
        FileError: they are in neither place.
    """
    spec = importlib.util.find_spec(PACKAGE)
    places = [] if spec is None else [Path(p) for p in spec.submodule_search_locations or ()]
    for place in (*places, Path(__file__).resolve().parents[2] / "conf"):
        if (place / "invert.yaml").is_file():
            return place
    raise FileError(f"the settings ({PACKAGE}) are not installed; pip install tactorch anew.")


def app_name(verb: str) -> str:
    """Return the name of a command's settings, and of its Hydra app: without a space."""
    return verb.replace(" ", "-")


class Catalog:
    """Settings and groups of one command."""

    def __init__(self, verb: str) -> None:
        """Read the command's own file; those of groups are read when asked for."""
        self.verb = verb
        self.folder = conf_folder()
        self.text = (self.folder / f"{app_name(verb)}.yaml").read_text(encoding="utf-8")
        self._content = _parse(self.text)

    @property
    def header(self) -> str:
        """What the command is, with examples."""
        return str(self._content["hydra"]["help"]["header"]).rstrip()

    @property
    def settings(self) -> dict[str, Any]:
        """The command's settings that belong to no group."""
        return {k: v for k, v in self._content.items() if k not in ("defaults", "hydra")}

    @cached_property
    def defaults(self) -> dict[str, str | None]:
        """The option of each group that is chosen by default."""
        entries = [entry for entry in self._content["defaults"] if isinstance(entry, dict)]
        merged: dict[str, str | None] = {}
        for entry in entries:
            merged |= entry
        return {group: option for group, option in merged.items() if group != "app"}

    def options(self, group: str) -> list[str]:
        """Names of the options of a group."""
        return sorted(path.stem for path in (self.folder / group).glob("*.yaml"))

    def option_text(self, group: str, option: str) -> str:
        """The file of an option; empty where it is the user's own."""
        path = self.folder / group / f"{option}.yaml"
        return path.read_text(encoding="utf-8") if path.is_file() else ""

    def about(self, group: str, option: str) -> str:
        """What the file of an option says of it in its first lines."""
        lines = self.option_text(group, option).splitlines()
        comments = [line.lstrip("# ") for line in lines if line.startswith("#")]
        return " ".join(line for line in comments if not line.startswith("@package"))

    def choices(self, given: Sequence[str]) -> dict[str, str | None]:
        """The option of each group once `given` settings (GROUP=OPTION among them) are applied."""
        chosen = dict(self.defaults)
        asked = dict(pair for pair in map(_pair, given) if pair[0] in chosen)
        for group, option in asked.items():
            for entry in _parse(self.option_text(group, option)).get("defaults", ()):
                chosen |= {
                    name.removeprefix("override /").split("@")[0]: value
                    for name, value in (entry.items() if isinstance(entry, dict) else ())
                    if name.startswith("override /")
                }
        return chosen | asked

    def keys(self, choices: Mapping[str, str | None]) -> list[str]:
        """Every setting by its full name, such as `optimizer.tolerance`."""
        found = list(_flat(self.settings))
        for group, option in choices.items():
            if option is not None and group != "experiment":
                found += [group, *(f"{group}.{k}" for k in self.option_keys(group, option))]
        return found

    def option_keys(self, group: str, option: str) -> list[str]:
        """Settings of an option, by their names within it."""
        content = _parse(self.option_text(group, option))
        return [key for key in _flat(content) if key.split(".")[0] not in ("name", "defaults")]


def _pair(setting: str) -> tuple[str, str]:
    key, _, value = setting.partition("=")
    return key.lstrip("+"), value


def _parse(text: str) -> dict[str, Any]:
    """Read names and nesting; OmegaConf, which reads some numbers better, takes longer to load."""
    import yaml

    content = yaml.load(text, getattr(yaml, "CSafeLoader", yaml.SafeLoader)) or {}
    assert isinstance(content, dict)
    return {str(key): value for key, value in content.items()}


def _flat(values: Mapping[str, Any]) -> Iterator[str]:
    """Full names of the settings in nested ones, the nests themselves included."""
    for key, value in values.items():
        yield str(key)
        if isinstance(value, Mapping):
            yield from (f"{key}.{inner}" for inner in _flat(value))

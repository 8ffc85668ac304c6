"""Composition of a command's settings by Hydra, from the typed defaults and the presets."""

from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from tactorch.cli.overrides import check_overrides
from tactorch.cli.presets import EXPERIMENT, Entry
from tactorch.cli.schema import Schema, app_name, load_schema, options_class
from tactorch.cli.sweep import SUBFOLDER
from tactorch.errors import ConfigError

if TYPE_CHECKING:
    from omegaconf import DictConfig

#: Hydra looks for settings here first: a package without any, so that it takes those of its store.
SEARCH_PACKAGE = "tactorch.config"
_LINES = {"format": "%(message)s", "class": "tactorch.text.PrintableFormatter"}
_PLAIN_LINES = {"formatters": {"simple": _LINES}}
#: What all commands share of Hydra's own settings: run folders and plain logs.
_HYDRA: Mapping[str, Any] = {
    "run": {"dir": "${run_dir}"},
    "sweep": {"dir": "${run_dir}", "subdir": SUBFOLDER},
    "job_logging": {
        **_PLAIN_LINES,
        "handlers": {"file": {"class": "tactorch.cli.console.RunLog"}},
        "loggers": {name: {"level": "WARNING"} for name in ("matplotlib", "torch")},
    },
    "hydra_logging": _PLAIN_LINES,
}


def store_config(schema: Schema, unnamed: Collection[str] = ()) -> str:
    """Register the settings of a command in Hydra's store, and return the config's name.

    Folders of the jobs of a sweep are not named by the settings `unnamed`.
    """
    from hydra.core.config_store import ConfigStore

    store, name = ConfigStore.instance(), app_name(schema.command)
    for group, found in schema.groups.items():
        for option, described in found["options"].items():
            node = {"name": described["component"]} if described["component"] else {}
            node |= _tree(described["settings"])
            node["defaults"] = [
                {f"override /{other}@_global_.{other}": chosen}
                for other, chosen in described["overrides"].items()
            ]
            store.store(group=group, name=option, node=node, provider="tactorch")
    for experiment, described in schema.experiments.items():
        overrides = [{f"override /{g}": option} for g, option in described["overrides"].items()]
        node = {"defaults": overrides, **described["values"]}
        store.store(experiment, node, EXPERIMENT, package="_global_", provider="tactorch")
    chosen = [{group: option} for group, option in schema.defaults.items()]
    named = {"override_dirname": {"exclude_keys": sorted(unnamed)}}
    job = {"name": name, "chdir": False, "config": named}
    node = {"defaults": ["_self_", *chosen], **_tree(schema.settings)}
    node["hydra"] = {**_HYDRA, "job": job, "help": {"app_name": f"tactorch {schema.command}"}}
    store.store(name=name, node=node, provider="tactorch")
    return name


def _tree(settings: Sequence[Entry]) -> dict[str, Any]:
    """Return the defaults of settings as a nested table."""
    tree: dict[str, Any] = {}
    for setting in settings:
        *tables, leaf = setting["name"].split(".")
        place = tree
        for table in tables:
            place = place.setdefault(table, {})
        place[leaf] = setting["default"]
    return tree


def build_options(command: str, cfg: "DictConfig") -> Any:
    """Return the typed options of a command."""
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException

    try:
        values = OmegaConf.to_container(cfg, resolve=True)
    except OmegaConfBaseException as error:
        reason = " ".join(str(error).split())
        raise ConfigError(f"a setting refers to a value that does not exist: {reason}.") from error
    assert isinstance(values, dict)
    return options_class(command).from_mapping({str(k): value for k, value in values.items()})


def compose_options(command: str, words: Sequence[str] = ()) -> Any:
    """Return the typed options of a command for settings as typed, without running it."""
    from hydra import compose, initialize_config_module

    schema = load_schema(command)
    checked = check_overrides(schema, words)
    with initialize_config_module(SEARCH_PACKAGE, version_base="1.3"):
        return build_options(command, compose(store_config(schema), checked))

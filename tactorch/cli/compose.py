"""Composition of a command's settings by Hydra, from the typed defaults and the presets."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tactorch.cli.overrides import check_overrides
from tactorch.cli.schema import EXPERIMENT, Schema, app_name, load_schema, options_class
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
    "sweep": {"dir": "${run_dir}", "subdir": "${hydra.job.num}"},
    "job_logging": {**_PLAIN_LINES, "loggers": {"matplotlib": {"level": "WARNING"}}},
    "hydra_logging": _PLAIN_LINES,
}


def store_config(schema: Schema) -> str:
    """Register the settings of a command in Hydra's store, and return the config's name."""
    from hydra.core.config_store import ConfigStore

    from tactorch.config.schema import tree_of

    store, name = ConfigStore.instance(), app_name(schema.command)
    for group, found in schema.groups.items():
        for option, described in found["options"].items():
            node = {"name": described["component"]} if described["component"] else {}
            node |= tree_of(described["settings"])
            node["defaults"] = [
                {f"override /{other}@_global_.{other}": chosen}
                for other, chosen in described["overrides"].items()
            ]
            store.store(group=group, name=option, node=node, provider="tactorch")
    for experiment, described in schema.experiments.items():
        overrides = [{f"override /{g}": option} for g, option in described["overrides"].items()]
        node = {"defaults": overrides, **described["values"]}
        store.store(
            group=EXPERIMENT, name=experiment, node=node, package="_global_", provider="tactorch"
        )
    chosen = [{group: option} for group, option in schema.defaults.items()]
    job = {"name": name, "chdir": False}
    node = {"defaults": ["_self_", *chosen], **tree_of(schema.settings)}
    node["hydra"] = {**_HYDRA, "job": job, "help": {"app_name": f"tactorch {schema.command}"}}
    store.store(name=name, node=node, provider="tactorch")
    return name


def build_options(command: str, cfg: "DictConfig") -> Any:
    """Return the typed options of a command.

    Raises:
        ConfigError: a setting is missing, unknown or holds a value that cannot be used.
    """
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException

    from tactorch.config import build

    try:
        values = OmegaConf.to_container(cfg, resolve=True)
    except OmegaConfBaseException as error:
        reason = " ".join(str(error).split())
        raise ConfigError(f"a setting refers to a value that does not exist: {reason}.") from error
    assert isinstance(values, dict)
    return build(options_class(command), {str(key): value for key, value in values.items()})


def compose_options(command: str, words: Sequence[str] = ()) -> Any:
    """Return the typed options of a command for settings as typed, without running it."""
    from hydra import compose, initialize_config_module

    schema = load_schema(command)
    checked = check_overrides(schema, words)
    with initialize_config_module(SEARCH_PACKAGE, version_base="1.3"):
        return build_options(command, compose(store_config(schema), checked))


def saved_options(command: str, run: Path) -> Any:
    """Return the typed options that a run folder holds.

    Raises:
        FileError: the folder holds no settings, or damaged ones.
        ConfigError: a setting cannot be used.
    """
    from tactorch.cli.resume import read_settings

    return build_options(command, read_settings(run))

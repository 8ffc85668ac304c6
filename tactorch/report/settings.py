"""The settings of an inversion, from what its result says of them."""

from collections.abc import Mapping
from typing import Any

from tactorch.errors import ConfigError
from tactorch.fem import NewtonOptions
from tactorch.inverse import (
    Bounds,
    NoiseModel,
    NuisancePrior,
    PriorOptions,
    Settings,
    make_optimizer,
)

_PARTS = {
    "prior": PriorOptions,
    "bounds": Bounds,
    "noise": NoiseModel,
    "newton": NewtonOptions,
    "nuisance": NuisancePrior,
}


def is_complete(config: Mapping[str, Any]) -> bool:
    """Whether a result holds all its settings: of a map that a prior is about, it does not."""
    prior = config.get("settings", {}).get("prior", {})
    return not isinstance(prior.get("mean_mpa"), str)


def settings_of(config: Mapping[str, Any]) -> Settings:
    """Return the settings that a reconstruction's `config` tells.

    Raises:
        ConfigError: it does not tell them all: it was written by another version, or the prior is
            about a map, of which only the checksum is kept.
    """
    if not is_complete(config):
        raise ConfigError("the prior was about a map that the result does not hold")
    try:
        values = dict(config["settings"])
        values["optimizer"] = make_optimizer(**config["optimizer"])
        values |= {name: make(**values[name]) for name, make in _PARTS.items()}
        return Settings(**values)
    except (KeyError, TypeError, ConfigError) as error:
        raise ConfigError(f"the result does not tell its settings as they are now ({error})") from (
            error
        )

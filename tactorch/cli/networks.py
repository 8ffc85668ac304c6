"""The networks that can be trained, each with the data that it learns from."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from omegaconf import DictConfig

from tactorch.cli.settings import build, plain
from tactorch.errors import ConfigError


@dataclass(frozen=True)
class Network:
    """A network and its data.

    Attributes:
        data: Name of the data that it learns from.
        make_data: Makes the data module from settings.
        make: Makes the module from settings.
        given: What the module takes from the data.
        facts: What a run notes of the data, beside their fingerprint.
    """

    data: str
    make_data: Callable[..., Any]
    make: Callable[..., Any]
    given: tuple[str, ...]
    facts: tuple[str, ...] = ()


def _recognition(**settings: Any) -> Any:
    from tactorch.learning.recognizer.data import RecognitionData

    return RecognitionData(**settings)


def _recognizer(**settings: Any) -> Any:
    from tactorch.learning.recognizer.network import Recognizer

    return Recognizer(**settings)


def _warmstart(**settings: Any) -> Any:
    from tactorch.learning.surrogate.data import SurrogateData

    return SurrogateData(**settings)


def _surrogate(**settings: Any) -> Any:
    from tactorch.learning.surrogate.network import Surrogate

    return Surrogate(**settings)


NETWORKS = {
    "recognizer": Network(
        "recognition", _recognition, _recognizer, ("classes", "mean", "deviation"), ("classes",)
    ),
    "surrogate": Network(
        "warmstart", _warmstart, _surrogate, ("press_scale", "shared_scale", "cells", "frames")
    ),
}


def network_of(cfg: DictConfig) -> Network:
    """Return the network that is asked for.

    Raises:
        ConfigError: It is unknown, or the data are not what it learns from.
    """
    if cfg.model.name not in NETWORKS:
        raise ConfigError(f"model '{cfg.model.name}' is unknown; choose {', '.join(NETWORKS)}.")
    network = NETWORKS[cfg.model.name]
    if cfg.data.name != network.data:
        raise ConfigError(
            f"model={cfg.model.name} learns from data={network.data}, not from"
            f" data={cfg.data.name}; give that."
        )
    return network


def data_of(cfg: DictConfig, number: int) -> Any:
    """Make the data module of a split."""
    settings = plain(cfg.data)
    del settings["name"]
    if settings["folder"] is None:
        raise ConfigError("data.folder=None: give the folder of a dataset.")
    settings["split"] += number
    return build("data", network_of(cfg).make_data, {**settings, "seed": cfg.seed})


def model_of(cfg: DictConfig, data: Any, known: Mapping[str, Any] | None = None) -> Any:
    """Make the network for the data, with weights that depend on the seed alone.

    What a run has `known` of its data counts before the data at hand.
    """
    import lightning

    network, settings = network_of(cfg), plain(cfg.model)
    del settings["name"]
    lightning.seed_everything(cfg.seed, verbose=False)
    noted = known or {}
    given = {name: noted.get(name, getattr(data, name, None)) for name in network.given}
    return build("model", network.make, {**given, **settings})


def facts_of(cfg: DictConfig, data: Any) -> dict[str, Any]:
    """Return what a run notes of its data."""
    noted = {name: getattr(data, name) for name in network_of(cfg).facts}
    return {"fingerprint": data.fingerprint, **noted}

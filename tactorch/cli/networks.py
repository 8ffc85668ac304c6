"""The networks that can be trained, each with the data that it learns from."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import lightning

from tactorch.config import ArgumentOptions, Registry, options_from_arguments
from tactorch.errors import ConfigError
from tactorch.learning.recognizer.data import RecognitionData
from tactorch.learning.recognizer.network import Recognizer
from tactorch.learning.surrogate.data import SurrogateData
from tactorch.learning.surrogate.network import Surrogate

if TYPE_CHECKING:
    from tactorch.cli.train import TrainOptions

_HERE = "tactorch.cli.networks"
#: Networks by name.
MODELS = Registry(
    "model",
    {
        "recognizer": f"{_HERE}:RecognizerOptions",
        "surrogate": f"{_HERE}:SurrogateOptions",
    },
    "networks",
)
#: Data modules by name.
DATA = Registry(
    "data",
    {
        "recognition": f"{_HERE}:RecognitionDataOptions",
        "warmstart": f"{_HERE}:SurrogateDataOptions",
    },
    "data to learn from",
)


@dataclass(frozen=True)
class DataUse:
    """Use of data by a network.

    Attributes:
        data: Name of the data module.
        arguments: Arguments of the network that are attributes of the data module.
        facts: Attributes of the data module that a run stores with its fingerprint.
    """

    data: str
    arguments: tuple[str, ...]
    facts: tuple[str, ...] = ()


_USES = {
    "recognizer": DataUse("recognition", ("classes", "mean", "deviation"), ("classes",)),
    "surrogate": DataUse("warmstart", ("press_scale", "shared_scale", "cells", "frames")),
}
RecognizerOptions = options_from_arguments(
    Recognizer, "model", without=_USES["recognizer"].arguments
)
SurrogateOptions = options_from_arguments(
    Surrogate, "model", without=(*_USES["surrogate"].arguments, "version")
)
RecognitionDataOptions = options_from_arguments(RecognitionData, "data", without=("seed",))
SurrogateDataOptions = options_from_arguments(SurrogateData, "data", without=("seed",))


def model_name(options: "TrainOptions") -> str:
    """Return the name of the network."""
    return MODELS.name_of(type(options.model))


def check_network(options: "TrainOptions") -> DataUse:
    """Return how the network uses its data.

    Raises:
        ConfigError: the data are not what the network learns from.
    """
    model, data = model_name(options), DATA.name_of(type(options.data))
    use = _USES[model]
    if data != use.data:
        raise ConfigError(
            f"model={model} learns from data={use.data}, not from data={data}; give that."
        )
    return use


def make_data(options: "TrainOptions", number: int) -> Any:
    """Return the data module of a split."""
    data: ArgumentOptions = options.data
    check_network(options)
    return with_split(data, number)(seed=options.seed)


def with_split(data: Any, number: int) -> Any:
    """Return the settings of the data with the seed of another split."""
    return replace(data, split=data.split + number)


def make_model(options: "TrainOptions", data: Any, stored: Mapping[str, Any] | None = None) -> Any:
    """Return the network for the data, with weights that depend on the seed only.

    Args:
        options: Settings of the training.
        data: The data module.
        stored: Facts that a run stored of its data; they take precedence.
    """
    lightning.seed_everything(options.seed, verbose=False)
    facts = stored or {}
    names = check_network(options).arguments
    given = {name: facts.get(name, getattr(data, name, None)) for name in names}
    return options.model(**given)


def data_facts(options: "TrainOptions", data: Any) -> dict[str, Any]:
    """Return the facts of the data that a run stores."""
    facts = {name: getattr(data, name) for name in check_network(options).facts}
    return {"fingerprint": data.fingerprint, **facts}

"""The networks that can be trained, each with the data that it learns from."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import lightning

from tactorch.cli.settings import CommandOptions
from tactorch.config import Registry, option, options_from_arguments
from tactorch.errors import ConfigError, FileError
from tactorch.files import read_json
from tactorch.learning.recognizer.data import RecognitionData
from tactorch.learning.recognizer.network import Recognizer
from tactorch.learning.surrogate.data import SurrogateData
from tactorch.learning.surrogate.network import Surrogate
from tactorch.learning.training import DataUse, TrainerOptions

DATA_FILE = "data.json"
#: What to do about a damaged file of a training.
REMEDY = "restore it, or train again."

_HERE = "tactorch.cli.networks"
_NETWORKS = {"recognizer": "RecognizerOptions", "surrogate": "SurrogateOptions"}
_DATA = {"recognition": "RecognitionDataOptions", "warmstart": "SurrogateDataOptions"}
MODELS = Registry("model", {n: f"{_HERE}:{c}" for n, c in _NETWORKS.items()})
DATA = Registry("data", {n: f"{_HERE}:{c}" for n, c in _DATA.items()})


RecognizerOptions = options_from_arguments(
    Recognizer, "model", without=Recognizer.data_use.arguments
)
SurrogateOptions = options_from_arguments(
    Surrogate, "model", without=(*Surrogate.data_use.arguments, "version")
)
RecognitionDataOptions = options_from_arguments(RecognitionData, "data", without=("seed",))
SurrogateDataOptions = options_from_arguments(SurrogateData, "data", without=("seed",))


@dataclass(frozen=True, kw_only=True)
class TrainOptions(CommandOptions):
    """Settings of a training."""

    model: Any = option("recognizer", "Network", section="model")
    data: Any = option("recognition", "Data to learn from", section="data")
    trainer: TrainerOptions = option(factory=TrainerOptions, help="Training", preset="cpu")
    resume: Path | None = option(None, "Run folder to continue")
    seed: int = option(0, "Seed of weights, order, augmentation and dropout", ge=0)
    splits: int = option(1, "Trainings, each on another split", ge=1)

    @property
    def model_name(self) -> str:
        """Name of the network."""
        return MODELS.name_of(type(self.model))

    def data_use(self) -> DataUse:
        """Return how the network uses its data."""
        model, data = self.model_name, DATA.name_of(type(self.data))
        use: DataUse | None = getattr(getattr(self.model, "function", None), "data_use", None)
        if use is None:
            raise ConfigError(
                f"model={model} does not declare its data; give its class the attribute data_use."
            )
        if data != use.data:
            raise ConfigError(
                f"model={model} learns from data={use.data}, not from data={data}; give that."
            )
        return use

    def make_data(self, number: int) -> Any:
        """Return the data module of a split."""
        self.data_use()
        return replace(self.data, split=self.data.split + number)(seed=self.seed)

    def make_model(self, data: Any, stored: Mapping[str, Any] | None = None) -> Any:
        """Return the network for the data, with weights that depend on the seed only.

        Facts that a run stored of its data take precedence.
        """
        lightning.seed_everything(self.seed, verbose=False)
        facts, names = stored or {}, self.data_use().arguments
        return self.model(**{name: facts.get(name, getattr(data, name, None)) for name in names})


def read_facts(folder: Path) -> dict[str, Any]:
    """Return the facts that a run stored of its data."""
    path = folder / DATA_FILE
    facts = read_json(path, "record of the training data", REMEDY, "fingerprint")
    classes = facts.get("classes", [])
    if not isinstance(classes, list) or not all(isinstance(name, str) for name in classes):
        raise FileError(f"'{path}': classes={classes!r} is no list of names; {REMEDY}")
    return facts


def check_data(folder: Path, data: Any) -> None:
    """Refuse data or a split other than those of the training, whose parts may overlap."""
    if (folder / DATA_FILE).is_file() and read_facts(folder)["fingerprint"] != data.fingerprint:
        raise ConfigError(
            f"'{folder}' was trained on other data, or on another split of them; give the same"
            " data.folder, data.split and data.shares, or train again."
        )

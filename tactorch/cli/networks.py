"""The networks that can be trained, each with the data that it learns from."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from tactorch.cli.settings import CommandOptions
from tactorch.config import Registry, option
from tactorch.errors import ConfigError
from tactorch.files import read_json
from tactorch.learning.loggers import LOGGERS  # noqa: F401  (the registry of `logger`)
from tactorch.learning.training import TrainerOptions

DATA_FILE = "data.json"
#: What to do about a damaged file of a training.
REMEDY = "restore it, or train again."

_LEARNING = "tactorch.learning"
MODELS = Registry(
    "model",
    {
        "recognizer": f"{_LEARNING}.recognizer:RecognizerOptions",
        "surrogate": f"{_LEARNING}.surrogate.network:SurrogateOptions",
    },
)
DATA = Registry(
    "data",
    {
        "recognition": f"{_LEARNING}.recognizer:RecognitionOptions",
        "warmstart": f"{_LEARNING}.surrogate.data:SurrogateDataOptions",
    },
)


@dataclass(frozen=True, kw_only=True)
class TrainOptions(CommandOptions):
    """Settings of a training."""

    model: Any = option("recognizer", "Network", section="model")
    data: Any = option("recognition", "Data to learn from", section="data")
    trainer: TrainerOptions = option(factory=TrainerOptions, help="Training", preset="cpu")
    logger: Any = option("tensorboard", "Logger of losses, settings and pictures", section="logger")
    pictures_every: int = option(
        10, "Epochs between pictures of predictions on the validation part; 0: none", ge=0
    )
    resume: Path | None = option(None, "Run folder to continue")
    seed: int = option(0, "Seed of weights, order, augmentation and dropout", ge=0)
    splits: int = option(1, "Trainings, each on another split", ge=1)

    @property
    def model_name(self) -> str:
        """Name of the network."""
        return MODELS.name_of(type(self.model))

    def make_data(self, number: int) -> Any:
        """Return the data module of a split."""
        data, needed = DATA.name_of(type(self.data)), getattr(self.model, "data", None)
        if needed is None:
            raise ConfigError(
                f"model={self.model_name} does not declare its data; give its options the attribute"
                " data."
            )
        if data != needed:
            raise ConfigError(
                f"model={self.model_name} learns from data={needed}, not from data={data}; give"
                " that."
            )
        return replace(self.data, split=self.data.split + number)(seed=self.seed)


def check_data(folder: Path, data: Any) -> None:
    """Refuse data or a split other than those of the training, whose parts may overlap."""
    path = folder / DATA_FILE
    if not path.is_file():
        return
    stored = read_json(path, "record of the training data", REMEDY, "fingerprint")
    if stored["fingerprint"] != data.fingerprint:
        raise ConfigError(
            f"'{folder}' was trained on other data, or on another split of them; give the same"
            " data.folder, data.split and data.shares, or train again."
        )

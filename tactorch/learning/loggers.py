"""Loggers of a training: where losses, hyperparameters and pictures are written."""

import io
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import PIL.Image
from lightning.pytorch.loggers import (
    CSVLogger,
    Logger,
    MLFlowLogger,
    TensorBoardLogger,
    WandbLogger,
)

from tactorch.config import Options, Registry, option
from tactorch.errors import ConfigError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_HOME = "tactorch.learning.loggers"
#: Loggers by name. Other packages add theirs by entry points of the group `tactorch.logger`.
LOGGERS = Registry(
    "logger",
    {
        "tensorboard": f"{_HOME}:TensorBoard",
        "csv": f"{_HOME}:Csv",
        "wandb": f"{_HOME}:WeightsAndBiases",
        "mlflow": f"{_HOME}:MlFlow",
        "none": f"{_HOME}:NoLogger",
    },
)


@dataclass(frozen=True, kw_only=True)
class LoggerOptions(Options, ABC):
    """Settings of a logger."""

    section: ClassVar[str] = "logger"

    @abstractmethod
    def build(self, folder: Path) -> Logger | None:
        """Return the logger of a run; its files are in the folder."""


@dataclass(frozen=True, kw_only=True)
class TensorBoard(LoggerOptions):
    """Files of TensorBoard in `tensorboard/`, with pictures and hyperparameters."""

    def build(self, folder: Path) -> Logger | None:
        return TensorBoardLogger(
            str(folder), name="", version="tensorboard", default_hp_metric=False
        )


@dataclass(frozen=True, kw_only=True)
class Csv(LoggerOptions):
    """A table `csv/metrics.csv`, with hyperparameters in `csv/hparams.yaml`."""

    def build(self, folder: Path) -> Logger | None:
        return CSVLogger(str(folder), name="", version="csv")


@dataclass(frozen=True, kw_only=True)
class WeightsAndBiases(LoggerOptions):
    """Weights & Biases; needs `pip install wandb`."""

    project: str = option("tactorch", "Name of the project")
    offline: bool = option(False, "Write files in the run's folder, for `wandb sync`")

    def build(self, folder: Path) -> Logger | None:
        _require("wandb")
        return WandbLogger(
            name=folder.name, save_dir=str(folder), project=self.project, offline=self.offline
        )


@dataclass(frozen=True, kw_only=True)
class MlFlow(LoggerOptions):
    """MLflow; needs `pip install mlflow`."""

    project: str = option("tactorch", "Name of the experiment")
    uri: str | None = option(None, "Address of the server; null: a folder `mlruns` in the run's")

    def build(self, folder: Path) -> Logger | None:
        _require("mlflow")
        uri = self.uri or (folder.resolve() / "mlruns").as_uri()
        try:
            return MLFlowLogger(
                experiment_name=self.project, run_name=folder.name, tracking_uri=uri
            )
        except ImportError as error:  # mlflow-skinny is not enough
            raise ConfigError(f"logger=mlflow cannot be used: {error}.") from error


@dataclass(frozen=True, kw_only=True)
class NoLogger(LoggerOptions):
    """No logger; `curve.json` has the losses in any case."""

    def build(self, folder: Path) -> Logger | None:
        return None


def _require(package: str) -> None:
    if find_spec(package) is None:
        raise ConfigError(f"logger={package} needs the package: pip install {package}.")


def log_figure(logger: Any, name: str, figure: "Figure", step: int) -> bool:
    """Log a picture with a logger of Lightning; return whether it takes pictures."""
    kind = type(logger).__name__
    if kind == "TensorBoardLogger":
        logger.experiment.add_figure(name, figure, global_step=step, close=False)
    elif kind == "WandbLogger":
        picture = io.BytesIO()
        figure.savefig(picture, format="png")
        logger.log_image(key=name, images=[PIL.Image.open(picture)], step=step)
    elif kind == "MLFlowLogger":
        file = f"{name.replace('/', '_')}-{step:06d}.png"
        logger.experiment.log_figure(logger.run_id, figure, file)
    else:
        return False
    return True


def log_scores(logger: Any, parameters: Mapping[str, Any], scores: Mapping[str, float]) -> None:
    """Log hyperparameters with the final scores, as the table of TensorBoard wants them."""
    if type(logger).__name__ == "TensorBoardLogger":
        logger.log_hyperparams(dict(parameters), dict(scores))
        logger.save()

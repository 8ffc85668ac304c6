"""`tactorch train`: train a network on a dataset of `tactorch generate`.

    tactorch train                                      the recognizer, on data/recognition
    tactorch train experiment=recognizer                the paper's split of 120 and 30, ten times
    tactorch train trainer=gpu trainer.max_epochs=200
    tactorch train -m model.hidden=32,64
    tactorch train resume=outputs/train/RUN             after a kill

The run folder gets the weights (best.ckpt), curve.json, scores.json and the files of the logger
(TensorBoard; logger=csv, wandb or mlflow).
"""

import logging
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import lightning
import numpy as np

from tactorch.cli.console import Table, log, log_text, progress
from tactorch.cli.model_outputs import Split, figures_of
from tactorch.cli.settings import CommandOptions, run_folder
from tactorch.config import Registry, option, to_mapping
from tactorch.errors import ConfigError
from tactorch.files import read_json, write_json
from tactorch.learning.loggers import log_figure
from tactorch.learning.training import EpochProgress, TrainerOptions, fit

DATA_FILE = "data.json"
#: What to do about a damaged file of a training.
REMEDY = "restore it, or train again."
# State of an earlier run in the same folder.
_STATE = ("*.ckpt", "split-*/*.ckpt", "scores.json", "split.json", "split-*/split.json")

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


class TrainingPictures(lightning.Callback):
    """Logs pictures of the predictions on the validation part, every few epochs and at the end.

    Without a validation part they are those of the test part, after training.
    """

    def __init__(self, data: Any, every: int) -> None:
        self._data, self._every = data, every

    def on_validation_epoch_end(
        self, trainer: lightning.Trainer, module: lightning.LightningModule
    ) -> None:
        """Draw and log the pictures, if the logger takes any."""
        epoch, last = trainer.current_epoch + 1, trainer.current_epoch + 1 == trainer.max_epochs
        if self._every and (last or epoch % self._every == 0):
            self._draw(trainer, module, "val")

    def on_test_epoch_end(
        self, trainer: lightning.Trainer, module: lightning.LightningModule
    ) -> None:
        """Draw and log the pictures of the test part, where there is no validation part."""
        if self._every and not self._data.parts["val"]:
            self._draw(trainer, module, "test")

    def _draw(
        self, trainer: lightning.Trainer, module: lightning.LightningModule, part: str
    ) -> None:
        if not (trainer.is_global_zero and trainer.logger and self._data.parts[part]):
            return
        for name, figure in figures_of(Split(module, self._data, part)).items():
            if not log_figure(trainer.logger, f"{part}/{name}", figure, trainer.global_step):
                return


def run(options: TrainOptions) -> dict[str, Any]:
    """Train, on one split or several, and write the scores."""
    import lightning.pytorch  # noqa: F401  (sets its own level)

    # Lightning's advice would hide what matters.
    logging.getLogger("lightning.pytorch").setLevel(logging.WARNING)
    warnings.filterwarnings("ignore", module="lightning")
    out, splits = run_folder(), options.splits
    if options.resume is None:
        for path in [path for pattern in _STATE for path in out.glob(pattern)]:
            path.unlink()
    rows = []
    for number in range(splits):
        rows.append(_train_split(options, number, split_folder(out, number, splits)))
        if splits > 1:
            scores = ", ".join(f"{name} {value:.4g}" for name, value in rows[-1].items())
            log.info("split %d of %d: %s", number + 1, splits, scores)
    values = {name: [row[name] for row in rows] for name in rows[0]}
    summary = {
        name: {"mean": float(np.mean(v)), "deviation": float(np.std(v, ddof=len(v) > 1))}
        for name, v in values.items()
    }
    result = {"splits": rows, "summary": summary}
    write_json(out / "scores.json", result)
    columns = ("mean", "deviation") if splits > 1 else ("mean",)  # deviations are over splits
    cells = [(name, *(f"{s[c]:.4g}" for c in columns)) for name, s in summary.items()]
    titles = columns if splits > 1 else ("",)
    log_text(Table(("score on the test part", *titles), cells))
    return result


def split_folder(run: Path, number: int, splits: int) -> Path:
    """Return the folder of a split in a run of so many."""
    return run if splits == 1 else run / f"split-{number:02d}"


def _train_split(options: TrainOptions, number: int, folder: Path) -> dict[str, float]:
    """Train on one split, unless its training is complete; return its scores."""
    done, mapping = folder / "split.json", to_mapping(options)
    settings = {name: mapping[name] for name in ("model", "data", "trainer", "seed")}
    if options.resume is not None and done.is_file():
        stored = read_json(done, "scores of a split", REMEDY, "settings", "scores")
        if stored["settings"] == settings:
            return dict(stored["scores"])
    data = options.make_data(number)
    if options.resume is not None:
        check_data(folder, data)
    if not data.parts["train"]:
        raise ConfigError("data.shares: no object to train on; give the first part a share.")
    write_json(folder / DATA_FILE, {"fingerprint": data.fingerprint})
    label = f"split {number + 1}" if options.splits > 1 else "training"
    trainer = replace(options.trainer, seed=options.seed)
    with progress(label, "epochs") as update:
        lightning.seed_everything(options.seed, verbose=False)
        callbacks = [EpochProgress(update), TrainingPictures(data, options.pictures_every)]
        scores = fit(options.model(data), data, folder, trainer, callbacks, logger=options.logger)
    write_json(done, {"settings": settings, "scores": scores})
    return scores


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

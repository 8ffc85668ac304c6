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
from dataclasses import replace
from pathlib import Path
from typing import Any

import lightning
import numpy as np

from tactorch.cli.console import Table, log, log_text, progress
from tactorch.cli.model_outputs import Split, figures_of
from tactorch.cli.networks import DATA_FILE, REMEDY, TrainOptions, check_data
from tactorch.cli.settings import run_folder
from tactorch.config import to_mapping
from tactorch.errors import ConfigError
from tactorch.files import read_json, write_json
from tactorch.learning.loggers import log_figure
from tactorch.learning.training import EpochProgress, fit

# State of an earlier run in the same folder.
_STATE = ("*.ckpt", "split-*/*.ckpt", "scores.json", "split.json", "split-*/split.json")


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

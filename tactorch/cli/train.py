"""`tactorch train`: train a network on a dataset of `tactorch generate`.

    tactorch train                                      the recognizer, on data/recognition
    tactorch train experiment=recognizer                the paper's split of 120 and 30, ten times
    tactorch train trainer=gpu trainer.max_epochs=200
    tactorch train -m model.hidden=32,64
    tactorch train resume=outputs/train/RUN             after a kill

The run folder gets the weights (best.ckpt), curve.json, scores.json and TensorBoard's files.
"""

import logging
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tactorch.cli.logs import log, log_text
from tactorch.cli.networks import check_network, data_facts, make_data, make_model
from tactorch.cli.options import CommandOptions
from tactorch.cli.outputs import write_json
from tactorch.cli.progress import progress
from tactorch.cli.settings import run_folder
from tactorch.cli.tables import Table
from tactorch.config import option, to_mapping
from tactorch.errors import ConfigError, FileError
from tactorch.files import read_json
from tactorch.learning.training import EpochProgress, TrainerOptions, fit

SCORES, DATA_FILE = "scores.json", "data.json"
_REMEDY = "restore it, or train again."


@dataclass(frozen=True, kw_only=True)
class TrainOptions(CommandOptions):
    """Settings of the command."""

    model: Any = option("recognizer", "Network", section="model")
    data: Any = option("recognition", "Data to learn from", section="data")
    trainer: TrainerOptions = option(factory=TrainerOptions, help="Training", preset="cpu")
    resume: Path | None = option(None, "Run folder to continue")
    seed: int = option(0, "Seed of weights, order, augmentation and dropout", ge=0)
    splits: int = option(1, "Trainings, each on another split", ge=1)


def run(options: TrainOptions) -> dict[str, Any]:
    """Train, on one split or several, and write the scores."""
    import lightning.pytorch  # noqa: F401  (sets its own level)

    # Lightning's advice would hide what matters.
    logging.getLogger("lightning.pytorch").setLevel(logging.WARNING)
    warnings.filterwarnings("ignore", module="lightning")
    out = run_folder()
    if options.resume is None:
        _clear(out)
    check_network(options)
    rows = []
    for number in range(options.splits):
        place = out if options.splits == 1 else out / f"split-{number:02d}"
        rows.append(_train_split(options, number, place))
        if options.splits > 1:
            log.info("split %d of %d: %s", number + 1, options.splits, _shown(rows[-1]))
    values = {name: [row[name] for row in rows] for name in rows[0]}
    summary = {
        name: {"mean": float(np.mean(v)), "deviation": float(np.std(v, ddof=len(v) > 1))}
        for name, v in values.items()
    }
    result = {"splits": rows, "summary": summary}
    write_json(out / SCORES, result)
    log_text(*_summed(summary, options.splits))
    return result


def _train_split(options: TrainOptions, number: int, place: Path) -> dict[str, float]:
    """Train on one split, unless its training is complete; return its scores."""
    done = place / "split.json"
    if options.resume is not None and done.is_file():
        stored = read_json(done, "scores of a split", _REMEDY, "settings", "scores")
        if stored["settings"] == _decisive(options):
            scores: dict[str, float] = stored["scores"]
            return scores
    data = make_data(options, number)
    if options.resume is not None:
        check_data(place, data)
    write_json(place / DATA_FILE, data_facts(options, data))
    label = f"split {number + 1}" if options.splits > 1 else "training"
    trainer = replace(options.trainer, seed=options.seed)
    with progress(label, "epochs") as update:
        callbacks = [EpochProgress(update)]
        scores = fit(make_model(options, data), data, place, trainer, callbacks)
    write_json(done, {"settings": _decisive(options), "scores": scores})
    return scores


def _decisive(options: TrainOptions) -> dict[str, Any]:
    """Return the settings that the result of a training depends on."""
    settings = to_mapping(options)
    return {name: settings[name] for name in ("model", "data", "trainer", "seed")}


def _clear(out: Path) -> None:
    """Remove the state of an earlier run in the same folder."""
    for pattern in ("*.ckpt", "split-*/*.ckpt", SCORES, "split.json", "split-*/split.json"):
        for stale in out.glob(pattern):
            stale.unlink()


def read_data(place: Path) -> dict[str, Any]:
    """Return the facts that a run stored of its data.

    Raises:
        FileError: the file is missing or damaged.
    """
    facts = read_json(place / DATA_FILE, "record of the training data", _REMEDY, "fingerprint")
    classes = facts.get("classes", [])
    if not isinstance(classes, list) or not all(isinstance(name, str) for name in classes):
        raise FileError(
            f"'{place / DATA_FILE}': classes={classes!r} is no list of names; {_REMEDY}"
        )
    return facts


def check_data(place: Path, data: Any) -> None:
    """Refuse data or a split other than those of the training, whose parts may overlap.

    Raises:
        ConfigError: they differ.
    """
    if (place / DATA_FILE).is_file() and read_data(place)["fingerprint"] != data.fingerprint:
        raise ConfigError(
            f"'{place}' was trained on other data, or on another split of them; give the same"
            " data.folder, data.split and data.shares, or train again."
        )


def _summed(summary: dict[str, dict[str, float]], splits: int) -> tuple[str, Table]:
    """Return scores as text and as a table; deviations are over splits."""
    names = ("mean", "deviation") if splits > 1 else ("mean",)
    rows = [
        (metric, *(f"{figures[name]:.4g}" for name in names)) for metric, figures in summary.items()
    ]
    table = Table(("score on the test part", *(names if splits > 1 else ("",))), rows)
    return table.text(), table


def _shown(scores: dict[str, float]) -> str:
    return ", ".join(f"{name} {value:.4g}" for name, value in scores.items())

"""`tactorch train`."""

import logging
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from omegaconf import DictConfig

from tactorch.cli.logs import log, tell
from tactorch.cli.networks import data_of, facts_of, model_of, network_of
from tactorch.cli.outputs import write_json
from tactorch.cli.progress import progress
from tactorch.cli.settings import build, folder, plain
from tactorch.cli.tables import Table
from tactorch.errors import ConfigError, FileError
from tactorch.files import read_json

SCORES, DATA = "scores.json", "data.json"
_REMEDY = "restore it, or train again."


def run(cfg: DictConfig) -> dict[str, Any]:
    """Train, on one split or several, and write the scores."""
    import lightning.pytorch  # noqa: F401  (sets its own level)

    # Lightning's advice would hide what matters.
    logging.getLogger("lightning.pytorch").setLevel(logging.WARNING)
    warnings.filterwarnings("ignore", module="lightning")
    out = folder()
    if cfg.resume is None:
        _clear(out)
    if cfg.splits < 1:
        raise ConfigError(f"splits={cfg.splits} must be at least 1.")
    network_of(cfg)
    rows = []
    for number in range(cfg.splits):
        place = out if cfg.splits == 1 else out / f"split-{number:02d}"
        rows.append(_scores_of(cfg, number, place))
        if cfg.splits > 1:
            log.info("split %d of %d: %s", number + 1, cfg.splits, _told(rows[-1]))
    values = {name: [row[name] for row in rows] for name in rows[0]}
    summary = {
        name: {"mean": float(np.mean(v)), "deviation": float(np.std(v, ddof=len(v) > 1))}
        for name, v in values.items()
    }
    result = {"splits": rows, "summary": summary}
    write_json(out / SCORES, result)
    tell(*_summed(summary, cfg.splits))
    return result


def _scores_of(cfg: DictConfig, number: int, place: Path) -> dict[str, float]:
    """Train on one split; one that had ended is not trained again."""
    from tactorch.learning.training import EpochsTold, TrainerOptions, fit

    options = build("trainer", TrainerOptions, {**plain(cfg.trainer), "seed": cfg.seed})
    done = place / "split.json"
    if cfg.resume is not None and done.is_file():
        ended = read_json(done, "scores of a split", _REMEDY, "settings", "scores")
        if ended["settings"] == _decisive(cfg):
            scores: dict[str, float] = ended["scores"]
            return scores
    data = data_of(cfg, number)
    if cfg.resume is not None:
        check_data(place, data)
    write_json(place / DATA, facts_of(cfg, data))
    label = f"split {number + 1}" if cfg.splits > 1 else "training"
    with progress(label, "epochs") as tell_epochs:
        told = [EpochsTold(tell_epochs)]
        scores = fit(model_of(cfg, data), data, place, options, told)
    write_json(done, {"settings": _decisive(cfg), "scores": scores})
    return scores


def _decisive(cfg: DictConfig) -> dict[str, Any]:
    """What a training's result depends on."""
    return {name: plain(cfg[name]) for name in ("model", "data", "trainer")} | {"seed": cfg.seed}


def _clear(out: Path) -> None:
    """Remove the state of an earlier run in the same folder: this one starts anew."""
    for pattern in ("*.ckpt", "split-*/*.ckpt", SCORES, "split.json", "split-*/split.json"):
        for stale in out.glob(pattern):
            stale.unlink()


def read_data(place: Path) -> dict[str, Any]:
    """Return what a run noted of its data.

    Raises:
        FileError: The file is missing or damaged.
    """
    facts = read_json(place / DATA, "record of the training data", _REMEDY, "fingerprint")
    classes = facts.get("classes", [])
    if not isinstance(classes, list) or not all(isinstance(name, str) for name in classes):
        raise FileError(f"'{place / DATA}': classes={classes!r} is no list of names; {_REMEDY}")
    return facts


def check_data(place: Path, data: Any) -> None:
    """Refuse data or a split that a network was not trained on: its test part may be known to it.

    Raises:
        ConfigError: They differ.
    """
    if (place / DATA).is_file() and read_data(place)["fingerprint"] != data.fingerprint:
        raise ConfigError(
            f"'{place}' was trained on other data, or on another split of them; give the same"
            " data.folder, data.split and data.shares, or train anew."
        )


def _summed(summary: dict[str, dict[str, float]], splits: int) -> tuple[str, Table]:
    """Return scores as text and as a table; deviations are over splits."""
    names = ("mean", "deviation") if splits > 1 else ("mean",)
    rows = [
        (metric, *(f"{figures[name]:.4g}" for name in names)) for metric, figures in summary.items()
    ]
    table = Table(("score on the test part", *(names if splits > 1 else ("",))), rows)
    return table.text(), table


def _told(scores: dict[str, float]) -> str:
    return ", ".join(f"{name} {value:.4g}" for name, value in scores.items())

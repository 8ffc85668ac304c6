"""`tactorch evaluate-model`."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from omegaconf import DictConfig, OmegaConf

from tactorch.cli.networks import data_of, model_of
from tactorch.cli.report import write_json
from tactorch.cli.settings import folder, log
from tactorch.cli.train import DATA, check_data
from tactorch.errors import ConfigError, FileError
from tactorch.files import require_file, require_folder

PARTS = ("train", "val", "test")


def run(cfg: DictConfig) -> dict[str, Any]:
    """Judge a trained network; writes numbers and pictures."""
    if cfg.part not in PARTS:
        raise ConfigError(f"part={cfg.part}: choose one of {', '.join(PARTS)}.")
    place = require_folder(str(cfg.run), "run to judge")
    trained = _settings(place)
    answers = [_answers(trained, place, n, cfg.folder, cfg.part) for n in range(trained.splits)]
    return _judge(answers, folder())


def _settings(place: Path) -> DictConfig:
    path = require_file(place / ".hydra" / "config.yaml", "settings of the run to judge")
    found = OmegaConf.load(path)
    if not isinstance(found, DictConfig) or "model" not in found or "data" not in found:
        raise FileError(f"'{place}' is no run of tactorch train.")
    return found


def _answers(
    trained: DictConfig, place: Path, number: int, other: str | None, part: str
) -> dict[str, Any]:
    """Probabilities for the samples of a part, or of another dataset, by one split's network."""
    import torch

    from tactorch.learning.training import BEST, load_weights

    settings = trained.copy()
    if other is not None:
        settings.data = {**settings.data, "folder": str(other), "shares": [0.0, 0.0, 1.0]}
        part = "test"
    data = data_of(settings, number)
    own = place if trained.splits == 1 else place / f"split-{number:02d}"
    known = json.loads(require_file(own / DATA, "what the run was trained on").read_text())
    if other is None:
        check_data(own, data)
    strange = set(data.classes) - set(known["classes"])
    if strange:
        raise ConfigError(
            f"'{other}' shows {', '.join(sorted(strange))}, and the network knows"
            f" {', '.join(known['classes'])} only."
        )
    truth = np.array([known["classes"].index(name) for name in data.classes])
    data.classes = known["classes"]
    model = model_of(settings, data)
    load_weights(model, own / BEST)
    places = data.parts[part]
    if not places:
        raise ConfigError(f"part={part} of the run's dataset is empty; choose another.")
    with torch.inference_mode():
        batches = data.maps[places].split(32)
        logits = torch.cat([model.eval()(maps) for maps in batches])
    return {
        "probabilities": logits.softmax(dim=1).double().numpy(),
        "truth": truth[data.labels[places].numpy()],
        "maps": data.maps[places][:, 0].double().numpy(),
        "classes": model.classes,
    }


def _judge(answers: list[dict[str, Any]], out: Path) -> dict[str, Any]:
    from tactorch.learning.scores import class_scores
    from tactorch.viz.recognition import plot_confusion, plot_examples, plot_reliability

    classes = answers[0]["classes"]
    each = [class_scores(a["probabilities"], a["truth"]).accuracy for a in answers]
    probabilities = np.concatenate([a["probabilities"] for a in answers])
    truth = np.concatenate([a["truth"] for a in answers])
    found = class_scores(probabilities, truth)
    plot_confusion(found.confusion, classes, out / "confusion.png")
    plot_reliability(found.confidence, found.right, found.counts, out / "calibration.png")
    named = probabilities.argmax(axis=1)
    titles = [
        f"{classes[t]}: {classes[n]} {p:.0%}"
        for t, n, p in zip(truth, named, probabilities.max(axis=1), strict=True)
    ]
    maps = np.concatenate([a["maps"] for a in answers])
    plot_examples(maps, titles, (named == truth).tolist(), out / "examples.png")
    result = {
        "samples": len(truth),
        "accuracy": found.accuracy,
        "accuracy_by_split": each,
        "accuracy_deviation": float(np.std(each, ddof=len(each) > 1)),
        "calibration_error": found.calibration_error,
        "classes": {
            name: {"precision": found.precision[i], "recall": found.recall[i], "f1": found.f1[i]}
            for i, name in enumerate(classes)
        },
        "confusion": found.confusion.tolist(),
    }
    write_json(out / "scores.json", result)
    log.info(
        "accuracy %.1f %% of %d answers (%d splits: %.1f +- %.1f %%), calibration error %.3f",
        100 * found.accuracy, len(truth), len(each), 100 * np.mean(each),
        100 * result["accuracy_deviation"], found.calibration_error,
    )  # fmt: skip
    for name, figures in result["classes"].items():
        log.info("%s: precision %.3f, recall %.3f", name, figures["precision"], figures["recall"])
    return result

"""Evaluation of a trained recognizer."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from tactorch.cli.logs import log, log_text
from tactorch.cli.tables import Table
from tactorch.errors import ConfigError
from tactorch.learning.recognizer.scores import class_scores
from tactorch.viz.calibration import plot_reliability
from tactorch.viz.learning import plot_confusion, plot_examples

_BATCH = 32


def evaluate(splits: Sequence[tuple[Any, Any, str, dict[str, Any]]], out: Path) -> dict[str, Any]:
    """Evaluate the networks of all splits; writes confusion.png, calibration.png, examples.png."""
    answers = [_answers(*split) for split in splits]
    classes = splits[0][3]["classes"]
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
    log.info(
        "accuracy %.1f %% of %d answers (%d splits: %.1f +- %.1f %%), calibration error %.3f",
        100 * found.accuracy, len(truth), len(each), 100 * np.mean(each),
        100 * result["accuracy_deviation"], found.calibration_error,
    )  # fmt: skip
    names = ("precision", "recall", "f1")
    rows = [
        (kind, *(f"{figures[name]:.3f}" for name in names))
        for kind, figures in result["classes"].items()
    ]
    table = Table(("class", *names), rows)
    log_text(table.text(), table)
    return result


def _answers(model: Any, data: Any, part: str, known: dict[str, Any]) -> dict[str, Any]:
    """Return probabilities for the samples of a part, by one split's network."""
    strange = set(data.classes) - set(known["classes"])
    if strange:
        raise ConfigError(
            f"the dataset shows {', '.join(sorted(strange))}, and the network knows"
            f" {', '.join(known['classes'])} only."
        )
    truth = np.array([known["classes"].index(name) for name in data.classes])
    places = data.parts[part]
    with torch.inference_mode():
        logits = torch.cat([model(maps) for maps in data.maps[places].split(_BATCH)])
    return {
        "probabilities": logits.softmax(dim=1).double().numpy(),
        "truth": truth[data.labels[places].numpy()],
        "maps": data.maps[places][:, 0].double().numpy(),
    }

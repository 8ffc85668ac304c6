"""Evaluation of a recognizer."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from tactorch.cli.logs import log, log_text
from tactorch.cli.tables import Table
from tactorch.errors import ConfigError
from tactorch.learning.recognizer.network import class_scores
from tactorch.viz import save_figure
from tactorch.viz.learning import confusion_figure, examples_figure, reliability_figure

_BATCH = 32


def evaluate(splits: Sequence[tuple[Any, Any, str, dict[str, Any]]], out: Path) -> dict[str, Any]:
    """Return the scores over all splits; writes confusion.png, calibration.png, examples.png.

    Args:
        splits: Network, data module, part, and stored facts of the data of each split.
        out: Folder of the pictures.
    """
    predictions = [_predict(*split) for split in splits]
    classes = splits[0][3]["classes"]
    by_split = [class_scores(p["probabilities"], p["truth"]).accuracy for p in predictions]
    probabilities, truth, maps = (
        np.concatenate([p[key] for p in predictions]) for key in ("probabilities", "truth", "maps")
    )
    scores = class_scores(probabilities, truth)
    save_figure(confusion_figure(scores.confusion, classes), out / "confusion.png")
    reliability = reliability_figure(scores.bin_confidence, scores.bin_accuracy, scores.bin_counts)
    save_figure(reliability, out / "calibration.png")
    predicted = probabilities.argmax(axis=1)
    titles = [
        f"{classes[t]}: {classes[n]} {p:.0%}"
        for t, n, p in zip(truth, predicted, probabilities.max(axis=1), strict=True)
    ]
    examples = examples_figure(maps, titles, (predicted == truth).tolist())
    save_figure(examples, out / "examples.png")
    result = {
        "samples": len(truth),
        "accuracy": scores.accuracy,
        "accuracy_by_split": by_split,
        "accuracy_deviation": float(np.std(by_split, ddof=len(by_split) > 1)),
        "calibration_error": scores.calibration_error,
        "classes": {
            name: {"precision": scores.precision[i], "recall": scores.recall[i], "f1": scores.f1[i]}
            for i, name in enumerate(classes)
        },
        "confusion": scores.confusion.tolist(),
    }
    log.info(
        "accuracy %.1f %% of %d predictions (%d splits: %.1f +- %.1f %%), calibration error %.3f",
        100 * scores.accuracy, len(truth), len(by_split), 100 * np.mean(by_split),
        100 * result["accuracy_deviation"], scores.calibration_error,
    )  # fmt: skip
    names = ("precision", "recall", "f1")
    rows = [
        (kind, *(f"{figures[name]:.3f}" for name in names))
        for kind, figures in result["classes"].items()
    ]
    table = Table(("class", *names), rows)
    log_text(table.text(), table)
    return result


def _predict(model: Any, data: Any, part: str, facts: dict[str, Any]) -> dict[str, Any]:
    """Return the probabilities that the network of a split predicts for a part."""
    unknown = set(data.classes) - set(facts["classes"])
    if unknown:
        raise ConfigError(
            f"the dataset contains {', '.join(sorted(unknown))}, and the network distinguishes"
            f" {', '.join(facts['classes'])} only; evaluate it on a dataset of these."
        )
    truth = np.array([facts["classes"].index(name) for name in data.classes])
    rows = data.parts[part]
    with torch.inference_mode():
        logits = torch.cat([model(maps) for maps in data.maps[rows].split(_BATCH)])
    return {
        "probabilities": logits.softmax(dim=1).double().numpy(),
        "truth": truth[data.labels[rows].numpy()],
        "maps": data.maps[rows][:, 0].double().numpy(),
    }

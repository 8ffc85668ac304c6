"""`tactorch evaluate-model`: evaluate a trained network, in numbers and pictures.

    tactorch evaluate-model run=outputs/train/RUN
    tactorch evaluate-model run=outputs/train/RUN folder=data/recognition_noisy

The run folder gets scores.json, calibration.png and examples.png, and for a recognizer
confusion.png. A run of several splits is evaluated on the test part of each.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import torch
from scipy.special import ndtri
from torch.nn import functional

from tactorch.cli.console import Table, log, log_text
from tactorch.cli.networks import TrainOptions, check_data
from tactorch.cli.resume import saved_options
from tactorch.cli.settings import CommandOptions, run_folder
from tactorch.cli.train import split_folder
from tactorch.config import option
from tactorch.errors import ConfigError
from tactorch.files import require_folder, write_json
from tactorch.findings.recognition import load_recognizer
from tactorch.learning.recognizer import class_scores
from tactorch.learning.surrogate.features import SHARED_CHANNELS
from tactorch.learning.surrogate.network import correlation, load_surrogate
from tactorch.learning.training import BEST
from tactorch.viz import save_figure
from tactorch.viz.learning import (
    confusion_figure,
    coverage_figure,
    examples_figure,
    predictions_figure,
    reliability_figure,
)

_BATCH = 32
_LEVELS = (0.1, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99)


@dataclass(frozen=True, kw_only=True)
class EvaluateModelOptions(CommandOptions):
    """Settings of the command."""

    run: Path = option(help="Run folder of `tactorch train`")
    folder: Path | None = option(
        None, "Another dataset to evaluate on, all of it; null: the run's own"
    )
    part: Literal["train", "val", "test"] = option("test", "Part of the run's own dataset")


class _Split(NamedTuple):
    """A trained network, its data module, and the part to evaluate on."""

    model: Any
    data: Any
    part: str


def run(options: EvaluateModelOptions) -> dict[str, Any]:
    """Evaluate a trained network; writes numbers and pictures."""
    folder, out = require_folder(options.run, "run to evaluate"), run_folder()
    trained: TrainOptions = saved_options("train", folder)
    evaluations = {"recognizer": _evaluate_recognizer, "surrogate": _evaluate_surrogate}
    if trained.model_name not in evaluations:
        raise ConfigError(
            f"model={trained.model_name} has no evaluation; its scores on the test part are in"
            f" '{folder / 'scores.json'}'."
        )
    splits = [_load_split(trained, folder, n, options) for n in range(trained.splits)]
    scores = evaluations[trained.model_name](splits, out)
    write_json(out / "scores.json", scores)
    return scores


def _load_split(
    trained: TrainOptions, folder: Path, number: int, options: EvaluateModelOptions
) -> _Split:
    """Return a split with the run's own data, or all of another dataset."""
    part: str = options.part
    if options.folder is not None:
        data = replace(trained.data, folder=options.folder, shares=(0.0, 0.0, 1.0))
        trained, part = replace(trained, data=data), "test"
    module = trained.make_data(number)
    own = split_folder(folder, number, trained.splits)
    if options.folder is None:
        check_data(own, module)
    if not module.parts[part]:
        raise ConfigError(f"part={part} of the run's dataset is empty; choose another.")
    load = load_recognizer if trained.model_name == "recognizer" else load_surrogate
    return _Split(load(own / BEST), module, part)


def _evaluate_recognizer(splits: Sequence[_Split], out: Path) -> dict[str, Any]:
    """Return the scores over all splits; writes confusion.png, calibration.png, examples.png."""
    classes = splits[0].model.classes
    results = [_classify(split) for split in splits]
    by_split = [class_scores(probabilities, truth).accuracy for probabilities, truth, _ in results]
    probabilities, truth, maps = map(np.concatenate, zip(*results, strict=True))
    scores = class_scores(probabilities, truth)
    save_figure(confusion_figure(scores.confusion, classes), out / "confusion.png")
    bins = scores.bin_confidence, scores.bin_accuracy, scores.bin_counts
    save_figure(reliability_figure(*bins), out / "calibration.png")
    predicted = probabilities.argmax(axis=1)
    titles = [
        f"{classes[t]}: {classes[n]} {p:.0%}"
        for t, n, p in zip(truth, predicted, probabilities.max(axis=1), strict=True)
    ]
    examples = examples_figure(maps, titles, (predicted == truth).tolist())
    save_figure(examples, out / "examples.png")
    deviation = float(np.std(by_split, ddof=len(by_split) > 1))
    log.info(
        "accuracy %.1f %% of %d predictions (%d splits: %.1f +- %.1f %%), calibration error %.3f",
        100 * scores.accuracy, len(truth), len(by_split), 100 * np.mean(by_split),
        100 * deviation, scores.calibration_error,
    )  # fmt: skip
    by_class = {
        name: {"precision": scores.precision[i], "recall": scores.recall[i], "f1": scores.f1[i]}
        for i, name in enumerate(classes)
    }
    rows = [(name, *(f"{v:.3f}" for v in values.values())) for name, values in by_class.items()]
    log_text(Table(("class", "precision", "recall", "f1"), rows))
    return {
        "samples": len(truth),
        "accuracy": scores.accuracy,
        "accuracy_by_split": by_split,
        "accuracy_deviation": deviation,
        "calibration_error": scores.calibration_error,
        "classes": by_class,
        "confusion": scores.confusion.tolist(),
    }


def _classify(split: _Split) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the probabilities that a network predicts, the true classes, and the maps."""
    data, classes = split.data, split.model.classes
    unknown = set(data.classes) - set(classes)
    if unknown:
        raise ConfigError(
            f"the dataset contains {', '.join(sorted(unknown))}, and the network distinguishes"
            f" {', '.join(classes)} only; evaluate it on a dataset of these."
        )
    truth = np.array([classes.index(name) for name in data.classes])
    rows = data.parts[split.part]
    with torch.inference_mode():
        logits = torch.cat([split.model(maps) for maps in data.maps[rows].split(_BATCH)])
    probabilities = logits.softmax(dim=1).double().numpy()
    return probabilities, truth[data.labels[rows].numpy()], data.maps[rows][:, 0].double().numpy()


def _evaluate_surrogate(splits: Sequence[_Split], out: Path) -> dict[str, Any]:
    """Return the scores over all splits; writes calibration.png and examples.png."""
    batches = [batch for split in splits for batch in _predict(split)]
    truth, mean, deviation, image, inside = map(torch.cat, zip(*batches, strict=True))
    correlations = correlation(mean.exp(), truth.exp(), inside)
    correlation_of_image = float(correlation(image.exp(), truth.exp(), inside).mean())
    errors = ((truth - mean).abs() / deviation)[inside]
    covered = [float((errors < ndtri(0.5 + 0.5 * level)).double().mean()) for level in _LEVELS]
    save_figure(coverage_figure(_LEVELS, covered), out / "calibration.png")
    maps = {"truth": truth, "image": image, "mean": mean, "deviation": deviation}
    fields = {name: values.double().numpy() for name, values in maps.items()}
    examples = predictions_figure(fields, inside.numpy(), correlations.tolist())
    save_figure(examples, out / "examples.png")
    quartiles = np.quantile(correlations.numpy(), (0.25, 0.5, 0.75)).tolist()
    result = {
        "samples": len(truth),
        "correlation": float(correlations.mean()),
        "correlation_quartiles": quartiles,
        "correlation_of_linear_image": correlation_of_image,
        "rms_log": float((truth - mean)[inside].double().square().mean().sqrt()),
        "rms_log_of_uniform": float(truth[inside].double().square().mean().sqrt()),
        "coverage": dict(zip(map(str, _LEVELS), covered, strict=True)),
    }
    log.info(
        "%d objects: correlation %.3f (quartiles %s), of the linear image %.3f",
        len(truth), result["correlation"], ", ".join(f"{q:.3f}" for q in quartiles),
        correlation_of_image,
    )  # fmt: skip
    log.info(
        "log-modulus: RMS error %.3f (uniform map: %.3f); coverage of 90 %% intervals %.1f %%",
        result["rms_log"], result["rms_log_of_uniform"], 100 * covered[_LEVELS.index(0.9)],
    )  # fmt: skip
    return result


def _predict(split: _Split) -> list[tuple[torch.Tensor, ...]]:
    """Return truth, mean, deviation, linear image and validity of each batch of a part."""
    batches: list[tuple[torch.Tensor, ...]] = []
    image = SHARED_CHANNELS.index("image")
    with torch.inference_mode():
        for presses, mask, shared, truth, inside in split.data.loader(split.part):
            mean, deviation = split.model(presses, mask, shared)
            fine = functional.interpolate(shared, scale_factor=2, mode="trilinear")[:, image]
            batches.append((truth, mean, deviation, fine, inside))
    return batches

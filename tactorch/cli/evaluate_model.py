"""`tactorch evaluate-model`: evaluate a trained network, in numbers and pictures.

    tactorch evaluate-model run=outputs/train/RUN
    tactorch evaluate-model run=outputs/train/RUN folder=data/recognition_noisy

The run folder gets scores.json, calibration.png and examples.png, and for a recognizer
confusion.png. A run of several splits is evaluated on the test part of each.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from matplotlib.figure import Figure
from scipy.special import ndtri

from tactorch.cli.console import Table, log, log_text
from tactorch.cli.model_outputs import (
    Answers,
    Split,
    answer_figures,
    classify,
    map_figures,
    predict,
)
from tactorch.cli.resume import saved_options
from tactorch.cli.settings import CommandOptions, run_folder
from tactorch.cli.train import TrainOptions, check_data, split_folder
from tactorch.config import option
from tactorch.errors import ConfigError
from tactorch.files import require_folder, write_json
from tactorch.learning.recognizer import class_scores, load_recognizer
from tactorch.learning.surrogate.network import correlation, load_surrogate
from tactorch.learning.training import BEST
from tactorch.viz import save_figure
from tactorch.viz.learning import coverage_figure, reliability_figure

_LEVELS = (0.1, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99)


@dataclass(frozen=True, kw_only=True)
class EvaluateModelOptions(CommandOptions):
    """Settings of the command."""

    run: Path = option(help="Run folder of `tactorch train`")
    folder: Path | None = option(
        None, "Another dataset to evaluate on, all of it; null: the run's own"
    )
    part: Literal["train", "val", "test"] = option("test", "Part of the run's own dataset")


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
    log.info("scores: %s", out / "scores.json")
    return scores


def _load_split(
    trained: TrainOptions, folder: Path, number: int, options: EvaluateModelOptions
) -> Split:
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
    return Split(load(own / BEST), module, part)


def _save(figures: Mapping[str, Figure], out: Path) -> None:
    for name, figure in sorted(figures.items()):
        log.info("picture: %s", save_figure(figure, out / f"{name}.png"))


def _evaluate_recognizer(splits: Sequence[Split], out: Path) -> dict[str, Any]:
    """Return the scores over all splits; writes confusion.png, calibration.png, examples.png."""
    classes = splits[0].model.classes
    results = [classify(split) for split in splits]
    by_split = [class_scores(probabilities, truth).accuracy for probabilities, truth, _ in results]
    probabilities, truth, maps = map(np.concatenate, zip(*results, strict=True))
    scores = class_scores(probabilities, truth)
    figures = answer_figures(Answers(probabilities, truth, maps), classes)
    bins = scores.bin_confidence, scores.bin_accuracy, scores.bin_counts
    _save({**figures, "calibration": reliability_figure(*bins)}, out)
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


def _evaluate_surrogate(splits: Sequence[Split], out: Path) -> dict[str, Any]:
    """Return the scores over all splits; writes calibration.png and examples.png."""
    batches = [batch for split in splits for batch in predict(split)]
    truth, mean, deviation, image, inside = map(torch.cat, zip(*batches, strict=True))
    correlations = correlation(mean.exp(), truth.exp(), inside)
    correlation_of_image = float(correlation(image.exp(), truth.exp(), inside).mean())
    errors = ((truth - mean).abs() / deviation)[inside]
    covered = [float((errors < ndtri(0.5 + 0.5 * level)).double().mean()) for level in _LEVELS]
    _save({**map_figures(batches), "calibration": coverage_figure(_LEVELS, covered)}, out)
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

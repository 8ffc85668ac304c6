"""Evaluation of a trained surrogate."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.special import ndtri
from torch.nn import functional

from tactorch.cli.settings import log
from tactorch.learning.surrogate.network import correlation
from tactorch.learning.surrogate.touch import SHARED_CHANNELS
from tactorch.viz.calibration import plot_coverage
from tactorch.viz.learning import plot_predictions

_LEVELS = (0.1, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99)


def evaluate(splits: Sequence[tuple[Any, Any, str, dict[str, Any]]], out: Path) -> dict[str, Any]:
    """Evaluate the networks of all splits; writes calibration.png and examples.png."""
    answers = [_answers(*split) for split in splits]
    joined = {key: torch.cat([a[key] for a in answers]) for key in answers[0]}
    truth, mean, inside = joined["truth"], joined["mean"], joined["inside"]
    found = correlation(mean.exp(), truth.exp(), inside)
    rough = correlation(joined["image"].exp(), truth.exp(), inside)
    off = ((truth - mean).abs() / joined["deviation"])[inside]
    covered = [float((off < ndtri(0.5 + 0.5 * level)).double().mean()) for level in _LEVELS]
    plot_coverage(_LEVELS, covered, out / "calibration.png")
    truth_, image, mean_, deviation = (
        joined[key].double().numpy() for key in ("truth", "image", "mean", "deviation")
    )
    shown = out / "examples.png"
    plot_predictions(truth_, image, mean_, deviation, inside.numpy(), found.tolist(), shown)
    result = {
        "samples": len(truth),
        "correlation": float(found.mean()),
        "correlation_quartiles": np.quantile(found.numpy(), (0.25, 0.5, 0.75)).tolist(),
        "correlation_of_linear_image": float(rough.mean()),
        "rms_log": float((truth - mean)[inside].double().square().mean().sqrt()),
        "rms_log_of_uniform": float(truth[inside].double().square().mean().sqrt()),
        "coverage": dict(zip(map(str, _LEVELS), covered, strict=True)),
    }
    log.info(
        "%d objects: correlation %.3f (quartiles %s), of the linear image alone %.3f",
        len(truth), result["correlation"],
        ", ".join(f"{q:.3f}" for q in result["correlation_quartiles"]),
        result["correlation_of_linear_image"],
    )  # fmt: skip
    log.info(
        "log-modulus: off by %.3f (a uniform map: %.3f); 90 %% intervals hold %.1f %% of the truth",
        result["rms_log"], result["rms_log_of_uniform"], 100 * covered[_LEVELS.index(0.9)],
    )  # fmt: skip
    return result


def _answers(model: Any, data: Any, part: str, known: dict[str, Any]) -> dict[str, torch.Tensor]:
    """Return the predictions of one split's network for a part, and the truth."""
    rows = []
    image = SHARED_CHANNELS.index("image")
    with torch.inference_mode():
        for presses, there, shared, truth, inside in data.loader(part):
            mean, deviation = model(presses, there, shared)
            rough = functional.interpolate(shared, scale_factor=2, mode="trilinear")[:, image]
            rows.append((truth, mean, deviation, rough, inside))
    names = ("truth", "mean", "deviation", "image", "inside")
    return {n: torch.cat(part) for n, part in zip(names, zip(*rows, strict=True), strict=True)}

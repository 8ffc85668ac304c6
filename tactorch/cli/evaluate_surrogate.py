"""Evaluation of a surrogate."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.special import ndtri
from torch.nn import functional

from tactorch.cli.logs import log
from tactorch.learning.surrogate.features import SHARED_CHANNELS
from tactorch.learning.surrogate.network import correlation
from tactorch.viz import save_figure
from tactorch.viz.learning import coverage_figure, predictions_figure

_LEVELS = (0.1, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99)


def evaluate(splits: Sequence[tuple[Any, Any, str, dict[str, Any]]], out: Path) -> dict[str, Any]:
    """Return the scores over all splits; writes calibration.png and examples.png.

    Args:
        splits: Network, data module, part, and stored facts of the data of each split.
        out: Folder of the pictures.
    """
    predictions = [_predict(model, data, part) for model, data, part, _ in splits]
    joined = {key: torch.cat([p[key] for p in predictions]) for key in predictions[0]}
    truth, mean, inside = joined["truth"], joined["mean"], joined["inside"]
    correlations = correlation(mean.exp(), truth.exp(), inside)
    of_image = correlation(joined["image"].exp(), truth.exp(), inside)
    errors = ((truth - mean).abs() / joined["deviation"])[inside]
    covered = [float((errors < ndtri(0.5 + 0.5 * level)).double().mean()) for level in _LEVELS]
    save_figure(coverage_figure(_LEVELS, covered), out / "calibration.png")
    fields = {name: values.double().numpy() for name, values in joined.items() if name != "inside"}
    examples = predictions_figure(fields, inside.numpy(), correlations.tolist())
    save_figure(examples, out / "examples.png")
    result = {
        "samples": len(truth),
        "correlation": float(correlations.mean()),
        "correlation_quartiles": np.quantile(correlations.numpy(), (0.25, 0.5, 0.75)).tolist(),
        "correlation_of_linear_image": float(of_image.mean()),
        "rms_log": float((truth - mean)[inside].double().square().mean().sqrt()),
        "rms_log_of_uniform": float(truth[inside].double().square().mean().sqrt()),
        "coverage": dict(zip(map(str, _LEVELS), covered, strict=True)),
    }
    log.info(
        "%d objects: correlation %.3f (quartiles %s), of the linear image %.3f",
        len(truth), result["correlation"],
        ", ".join(f"{q:.3f}" for q in result["correlation_quartiles"]),
        result["correlation_of_linear_image"],
    )  # fmt: skip
    log.info(
        "log-modulus: RMS error %.3f (uniform map: %.3f); coverage of 90 %% intervals %.1f %%",
        result["rms_log"], result["rms_log_of_uniform"], 100 * covered[_LEVELS.index(0.9)],
    )  # fmt: skip
    return result


def _predict(model: Any, data: Any, part: str) -> dict[str, torch.Tensor]:
    """Return the prediction of a network for a part, and the truth."""
    rows = []
    image = SHARED_CHANNELS.index("image")
    with torch.inference_mode():
        for presses, mask, shared, truth, inside in data.loader(part):
            mean, deviation = model(presses, mask, shared)
            fine = functional.interpolate(shared, scale_factor=2, mode="trilinear")[:, image]
            rows.append((truth, mean, deviation, fine, inside))
    names = ("truth", "mean", "deviation", "image", "inside")
    return {n: torch.cat(part) for n, part in zip(names, zip(*rows, strict=True), strict=True)}

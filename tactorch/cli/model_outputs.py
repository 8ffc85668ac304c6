"""Predictions of trained networks on a part of their data, and figures of them."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from matplotlib.figure import Figure
from torch import Tensor
from torch.nn import functional

from tactorch.errors import ConfigError
from tactorch.learning.recognizer import Recognizer, class_scores
from tactorch.learning.surrogate.features import SHARED_CHANNELS
from tactorch.learning.surrogate.network import Surrogate, correlation
from tactorch.viz.learning import confusion_figure, examples_figure, predictions_figure

_BATCH = 32


class Split(NamedTuple):
    """A network, its data module, and the part to evaluate on."""

    model: Any
    data: Any
    part: str


class Answers(NamedTuple):
    """Predictions of a recognizer: probabilities, true classes, and maps of log-modulus."""

    probabilities: Float[np.ndarray, "n c"]
    truth: Int[np.ndarray, " n"]
    maps: Float[np.ndarray, "n v v v"]


def classify(split: Split) -> Answers:
    """Return the predictions of a recognizer.

    Raises:
        ConfigError: The data have classes that it does not know.
    """
    data, classes = split.data, split.model.classes
    unknown = set(data.classes) - set(classes)
    if unknown:
        raise ConfigError(
            f"the dataset contains {', '.join(sorted(unknown))}, and the network distinguishes"
            f" {', '.join(classes)} only; evaluate it on a dataset of these."
        )
    truth = np.array([classes.index(name) for name in data.classes])
    rows = data.parts[split.part]
    device = split.model.device
    with torch.inference_mode():
        batches = data.maps[rows].split(_BATCH)
        logits = torch.cat([split.model(maps.to(device)).cpu() for maps in batches])
    probabilities = logits.softmax(dim=1).double().numpy()
    maps = data.maps[rows][:, 0].double().numpy()
    return Answers(probabilities, truth[data.labels[rows].numpy()], maps)


def predict(split: Split) -> list[tuple[Tensor, ...]]:
    """Return truth, mean, deviation, linear image and validity of each batch of a part."""
    batches: list[tuple[Tensor, ...]] = []
    image, device = SHARED_CHANNELS.index("image"), split.model.device
    with torch.inference_mode():
        for presses, mask, shared, truth, inside in split.data.loader(split.part):
            given = (tensor.to(device) for tensor in (presses, mask, shared))
            mean, deviation = (tensor.cpu() for tensor in split.model(*given))
            fine = functional.interpolate(shared, scale_factor=2, mode="trilinear")[:, image]
            batches.append((truth, mean, deviation, fine, inside))
    return batches


def answer_figures(answers: Answers, classes: Sequence[str]) -> dict[str, Figure]:
    """Return figures `confusion` and `examples` of a recognizer's predictions."""
    probabilities, truth, maps = answers
    predicted = probabilities.argmax(axis=1)
    titles = [
        f"{classes[t]}: {classes[n]} {p:.0%}"
        for t, n, p in zip(truth, predicted, probabilities.max(axis=1), strict=True)
    ]
    return {
        "confusion": confusion_figure(class_scores(probabilities, truth).confusion, classes),
        "examples": examples_figure(maps, titles, (predicted == truth).tolist()),
    }


def map_figures(batches: Sequence[tuple[Tensor, ...]]) -> dict[str, Figure]:
    """Return the figure `examples` of a surrogate's predictions."""
    truth, mean, deviation, image, inside = map(torch.cat, zip(*batches, strict=True))
    correlations = correlation(mean.exp(), truth.exp(), inside)
    maps = {"truth": truth, "image": image, "mean": mean, "deviation": deviation}
    fields = {name: values.double().numpy() for name, values in maps.items()}
    return {"examples": predictions_figure(fields, inside.numpy(), correlations.tolist())}


def figures_of(split: Split) -> Mapping[str, Figure]:
    """Return figures of the predictions of a network; none for one of another package."""
    if isinstance(split.model, Recognizer):
        return answer_figures(classify(split), split.model.classes)
    if isinstance(split.model, Surrogate):
        return map_figures(predict(split))
    return {}

"""The recognizer: classifies the inclusion in a map of Young's modulus (Section V-B); scores."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor, nn
from torch.nn import functional

from tactorch.errors import ConfigError
from tactorch.learning.training import DataUse, Network


class FCN(nn.Module):
    """A 3-D fully convolutional network (Long et al., 2015) with one score per class and voxel.

    Scores are averaged over the voxels, so that grids of any size from 4 voxels in each direction
    are accepted. The first two of the hidden layers halve the grid.
    """

    def __init__(
        self, classes: int, hidden: int = 64, layers: int = 4, dropout: float = 0.3
    ) -> None:
        super().__init__()
        if min(classes, hidden, layers) < 1:
            raise ConfigError("classes, hidden and layers must be at least 1.")
        if not 0 <= dropout < 1:
            raise ConfigError(f"dropout={dropout} must be a share in [0, 1).")
        blocks: list[nn.Module] = []
        for layer in range(layers):
            channels = 1 if layer == 0 else hidden
            stride = 2 if layer < 2 else 1
            blocks += [
                nn.Conv3d(channels, hidden, 3, stride=stride, padding=1, bias=False),
                nn.BatchNorm3d(hidden),
                nn.ReLU(),
            ]
        self.hidden = nn.Sequential(*blocks)
        self.drop = nn.Dropout3d(dropout)
        self.score = nn.Conv3d(hidden, classes, 1)

    def forward(self, maps: Float[Tensor, "b 1 x y z"]) -> Float[Tensor, "b c"]:
        """Return the logits of each class."""
        return self.score(self.drop(self.hidden(maps))).mean(dim=(2, 3, 4))


class Recognizer(Network):
    """Classifies inclusions from log-modulus on a grid.

    Args:
        classes: Names of the classes.
        mean: Mean log-modulus of the training maps; stored with the weights.
        deviation: Standard deviation of the log-modulus; stored with the weights.
        hidden: Channels of the hidden layers.
        layers: Number of hidden layers.
        dropout: Fraction of channels dropped before the last layer, in training.
        learning_rate: Largest learning rate of AdamW.
        weight_decay: Weight decay of AdamW.
    """

    data_use = DataUse("recognition", ("classes", "mean", "deviation"), ("classes",))
    mean: Tensor
    deviation: Tensor

    def __init__(
        self,
        classes: Sequence[str],
        mean: float = 0.0,
        deviation: float = 1.0,
        hidden: int = 64,
        layers: int = 4,
        dropout: float = 0.3,
        learning_rate: float = 2e-3,
        weight_decay: float = 1e-4,
    ) -> None:
        super().__init__(learning_rate, weight_decay)
        self.save_hyperparameters()
        self.classes = list(classes)
        self.register_buffer("mean", torch.tensor(float(mean)))
        self.register_buffer("deviation", torch.tensor(float(deviation)))
        self.network = FCN(len(self.classes), hidden, layers, dropout)

    def forward(self, log_youngs: Float[Tensor, "b 1 x y z"]) -> Float[Tensor, "b c"]:
        """Return the logits of each class for maps of log-modulus (MPa)."""
        return self.network((log_youngs - self.mean) / self.deviation)

    def training_step(self, batch: Sequence[Tensor], index: int) -> Tensor:
        """Return the cross-entropy of a batch."""
        loss = self.scores(batch)["loss"]
        self.log("train/loss", loss, on_step=False, on_epoch=True, sync_dist=True)
        return loss

    def predict_step(self, batch: Sequence[Tensor], index: int) -> Tensor:
        """Return the probability of each class."""
        return self(batch[0]).softmax(dim=1)

    def scores(self, batch: Sequence[Tensor]) -> dict[str, Tensor]:
        """Return the cross-entropy and the accuracy of a batch."""
        maps, labels = batch
        logits = self(maps)
        accuracy = (logits.argmax(dim=1) == labels).double().mean()
        return {"loss": functional.cross_entropy(logits, labels), "accuracy": accuracy}


class ClassScores(NamedTuple):
    """Scores of n predictions of c classes.

    Rows of the confusion matrix are true classes, columns predicted ones. Precision is NaN for
    classes that were never predicted, recall for those that never occurred. The calibration error
    is the expected one of Guo et al. (2017). Bins are of the confidence, the probability of the
    predicted class; means over empty bins are NaN.
    """

    confusion: Int[np.ndarray, "c c"]
    accuracy: float
    precision: Float[np.ndarray, " c"]
    recall: Float[np.ndarray, " c"]
    f1: Float[np.ndarray, " c"]
    calibration_error: float
    bin_confidence: Float[np.ndarray, " b"]
    bin_accuracy: Float[np.ndarray, " b"]
    bin_counts: Int[np.ndarray, " b"]


def class_scores(
    probabilities: Float[np.ndarray, "n c"], truth: Int[np.ndarray, " n"], bins: int = 10
) -> ClassScores:
    """Return scores of predicted probabilities, binned for the calibration.

    Raises:
        ConfigError: There are no predictions, or a class is out of range.
    """
    count, classes = probabilities.shape
    if count == 0 or truth.min() < 0 or truth.max() >= classes:
        raise ConfigError(f"{count} answers among {classes} classes do not fit the true classes.")
    predicted = probabilities.argmax(axis=1)
    confusion = np.zeros((classes, classes), dtype=np.int64)
    np.add.at(confusion, (truth, predicted), 1)
    hits = np.diag(confusion).astype(float)
    with np.errstate(invalid="ignore", divide="ignore"):
        precision, recall = hits / confusion.sum(axis=0), hits / confusion.sum(axis=1)
        f1 = 2.0 * hits / (confusion.sum(axis=0) + confusion.sum(axis=1))
        confidence = probabilities.max(axis=1)
        index = np.minimum((confidence * bins).astype(int), bins - 1)
        bin_counts = np.bincount(index, minlength=bins)
        bin_confidence = np.bincount(index, confidence, minlength=bins) / bin_counts
        bin_accuracy = np.bincount(index, predicted == truth, minlength=bins) / bin_counts
    error = np.nansum(bin_counts * np.abs(bin_confidence - bin_accuracy)) / count
    accuracy, in_bins = float(hits.sum() / count), (bin_confidence, bin_accuracy, bin_counts)
    return ClassScores(confusion, accuracy, precision, recall, f1, float(error), *in_bins)

"""The recognizer: which inclusion a map of Young's modulus shows (Section V-B), and its scores."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor, nn
from torch.nn import functional

from tactorch.config import option
from tactorch.errors import ConfigError
from tactorch.generation import SampleMaps, SampleSet
from tactorch.learning.data import (
    IDENTITY,
    DataOptions,
    SplitData,
    Symmetry,
    apply_symmetry,
    symmetries,
)
from tactorch.learning.training import BEST, Network, NetworkOptions, load_network
from tactorch.mesh import TetMesh, VoxelGrid
from tactorch.metrics.segment import check_field


@dataclass(frozen=True, kw_only=True)
class RecognitionOptions(DataOptions):
    """Log-modulus on a grid and the class of the inclusion."""

    folder: Path = option(help="Dataset, such as of `tactorch generate dataset=recognition`")
    voxels: int = option(24, "Voxels in each direction", ge=1)
    source: Literal["reconstruction", "truth"] = option("reconstruction", "Maps to use")
    brightness: float = option(
        0.1, "Standard deviation of the logarithm of the factor on the modulus of augmented maps"
    )

    def __call__(self, *, seed: int) -> "RecognitionData":
        """Return the data module."""
        return RecognitionData(self, seed)


class RecognitionData(SplitData):
    """Log-modulus on a grid and the class of the inclusion.

    Args:
        options: Settings.
        seed: Seed of order and augmentation.

    Raises:
        FileError: The dataset is missing or damaged.
        ConfigError: The dataset has no reconstructions.
    """

    def __init__(self, options: RecognitionOptions, seed: int = 0) -> None:
        dataset = SampleSet(options.folder)
        dataset.verify()
        samples = [dataset.maps(index) for index in dataset.indices]
        if not samples:
            raise ConfigError(f"dataset '{options.folder}' is empty.")
        objects, labels = [s.object for s in samples], [s.label for s in samples]
        grids = {sample.mesh: VoxelGrid(sample.mesh, options.voxels) for sample in samples}
        maps = [_log_map(sample, options.source, grids[sample.mesh]) for sample in samples]
        super().__init__(options, seed, dataset.manifest, objects, labels)
        self.maps, self.brightness = torch.stack(maps), options.brightness
        self.classes = sorted(set(labels))
        self.labels = torch.tensor([self.classes.index(label) for label in labels])
        self.allowed = _common_symmetries(samples)

    @property
    def mean(self) -> float:
        """Mean of the training maps."""
        return float(self.maps[self.parts["train"]].mean())

    @property
    def deviation(self) -> float:
        """Standard deviation of the training maps."""
        return float(self.maps[self.parts["train"]].std())

    def sample(
        self, row: int, symmetry: Symmetry = IDENTITY, deviate: float = 0.0
    ) -> tuple[Tensor, Tensor]:
        """Return a map and its label; the logarithm is shifted by `deviate` times brightness."""
        image = apply_symmetry(symmetry, self.maps[row]) + self.brightness * deviate
        return image, self.labels[row]


def _log_map(sample: SampleMaps, source: str, grid: VoxelGrid) -> Tensor:
    youngs = sample.truth if source == "truth" else sample.reconstruction
    if youngs is None:
        raise ConfigError(
            "the dataset has no reconstructions; generate it with dataset.reconstruct=true, or"
            " learn from data.source=truth."
        )
    return torch.from_numpy(np.log(grid.fill(youngs))).float()[None]


def _common_symmetries(samples: Sequence[SampleMaps]) -> list[Symmetry]:
    if any(sample.pushes is None for sample in samples):
        return [IDENTITY]
    sets = [symmetries(sample.pushes) for sample in samples if sample.pushes is not None]
    return [symmetry for symmetry in sets[0] if all(symmetry in other for other in sets[1:])]


class FCN(nn.Module):
    """A 3-D fully convolutional network (Long et al., 2015) with one score per class and voxel.

    Scores are averaged over the voxels, so that grids of any size from 4 voxels in each direction
    are accepted. The first two of the hidden layers halve the grid.
    """

    def __init__(
        self, classes: int, hidden: int = 64, layers: int = 4, dropout: float = 0.3
    ) -> None:
        super().__init__()
        blocks: list[nn.Module] = []
        for layer in range(layers):
            channels = 1 if layer == 0 else hidden
            stride = 2 if layer < 2 else 1
            convolution = nn.Conv3d(channels, hidden, 3, stride=stride, padding=1, bias=False)
            blocks += [convolution, nn.BatchNorm3d(hidden), nn.ReLU()]
        self.hidden = nn.Sequential(*blocks)
        self.drop = nn.Dropout3d(dropout)
        self.score = nn.Conv3d(hidden, classes, 1)

    def forward(self, maps: Float[Tensor, "b 1 x y z"]) -> Float[Tensor, "b c"]:
        """Return the logits of each class."""
        return self.score(self.drop(self.hidden(maps))).mean(dim=(2, 3, 4))


@dataclass(frozen=True, kw_only=True)
class RecognizerOptions(NetworkOptions):
    """Classifies inclusions from log-modulus on a grid."""

    data: ClassVar[str] = "recognition"
    hidden: int = option(64, "Channels of the hidden layers", ge=1)
    layers: int = option(4, "Number of hidden layers", ge=1)
    dropout: float = option(
        0.3, "Fraction of channels dropped before the last layer, in training", ge=0, lt=1
    )
    weight_decay: float = option(1e-4, "Weight decay of AdamW", ge=0)

    def __call__(self, data: RecognitionData) -> "Recognizer":
        """Return the network for some data."""
        return Recognizer(data.classes, data.mean, data.deviation, **vars(self))


class Recognizer(Network):
    """Classifies inclusions from log-modulus on a grid.

    Args:
        classes: Names of the classes.
        mean: Mean log-modulus of the training maps; stored with the weights.
        deviation: Standard deviation of the log-modulus; stored with the weights.
        options: Settings, see `RecognizerOptions`.
    """

    mean: Tensor
    deviation: Tensor

    def __init__(
        self, classes: Sequence[str], mean: float = 0.0, deviation: float = 1.0, **options: Any
    ) -> None:
        settings = RecognizerOptions(**options)
        super().__init__(settings)
        self.save_hyperparameters()
        if not classes:
            raise ConfigError("a recognizer needs at least one class; give classes=[NAME, ...].")
        self.classes = list(classes)
        self.register_buffer("mean", torch.tensor(float(mean)))
        self.register_buffer("deviation", torch.tensor(float(deviation)))
        self.network = FCN(len(classes), settings.hidden, settings.layers, settings.dropout)

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


def load_recognizer(path: str | Path) -> Recognizer:
    """Read a trained recognizer: the folder of its run, of one of its splits, or a checkpoint."""
    checkpoint = Path(path)
    if checkpoint.is_dir():
        files = [checkpoint / BEST, *sorted(checkpoint.glob(f"split-*/{BEST}"))]
        checkpoint = next((file for file in files if file.is_file()), files[0])
    advice = "give the run of `tactorch train experiment=recognizer`"
    return load_network(Recognizer, checkpoint, "recognizer", advice)


def recognise(
    mesh: TetMesh, youngs: Float[np.ndarray, " m"], recognizer: Recognizer, *, voxels: int = 24
) -> dict[str, float]:
    """Return the probability of each shape, in descending order.

    Only shapes that the recognizer was trained on are considered. The map has `voxels` in each
    direction, 24 by default as in training; the network accepts any number.
    """
    check_field("youngs", youngs, mesh)
    grid = VoxelGrid(mesh, voxels)
    volume = torch.from_numpy(np.log(grid.fill(youngs))).float()[None, None]
    with torch.no_grad():
        probabilities = recognizer.eval()(volume).softmax(dim=1)[0].tolist()
    by_name = dict(zip(recognizer.classes, probabilities, strict=True))
    return dict(sorted(by_name.items(), key=lambda item: -item[1]))


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

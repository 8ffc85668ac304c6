"""Presses and true maps for the training of a surrogate."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from tactorch.errors import ConfigError
from tactorch.generation import SampleSet
from tactorch.learning.data import (
    IDENTITY,
    PARTS,
    SplitData,
    Symmetry,
    apply_symmetry,
    split_objects,
    symmetries,
)
from tactorch.learning.surrogate.features import PRESS_VECTORS, VERSION, load_features

Row = tuple[Tensor, Tensor, Tensor, Tensor]


def collate(rows: Sequence[Row]) -> list[Tensor]:
    """Return presses (padded with zeros), their mask, fields of the objects, targets and masks."""
    counts = torch.tensor([len(presses) for presses, *_ in rows])
    largest = int(counts.max())
    padded = rows[0][0].new_zeros((len(rows), largest, *rows[0][0].shape[1:]))
    for out, (presses, *_) in zip(padded, rows, strict=True):
        out[: len(presses)] = presses
    mask = torch.arange(largest)[None] < counts[:, None]
    others = [torch.stack(parts) for parts in list(zip(*rows, strict=True))[1:]]
    return [padded, mask, *others]


class SurrogateData(SplitData):
    """Presses and true log-moduli on a grid.

    The features are computed once and cached in the folder of the dataset.

    Args:
        folder: Dataset, such as of `tactorch generate dataset=warmstart`.
        cells: Cells of the features in each direction; targets have twice as many.
        frames: Load steps to use per press location.
        batch: Objects per batch.
        shares: Fractions of the objects in training, validation and test.
        split: Seed of the split.
        augment: Whether to rotate and mirror training objects with their presses.
        seed: Seed of order and augmentation.

    Raises:
        FileError: The dataset is missing or damaged.
        ConfigError: A setting is not valid.
    """

    collate = staticmethod(collate)
    allowed = symmetries(np.zeros((0, 3)))

    def __init__(
        self,
        folder: str | Path,
        *,
        cells: int = 8,
        frames: int = 1,
        batch: int = 16,
        shares: tuple[float, float, float] = (0.9, 0.05, 0.05),
        split: int = 0,
        augment: bool = True,
        seed: int = 0,
    ) -> None:
        if batch < 1 or split < 0 or seed < 0:
            raise ConfigError("batch must be at least 1, split and seed at least 0.")
        if cells < 4 or cells % 2:
            raise ConfigError(f"cells={cells} must be even, and at least 4.")
        features = load_features(folder, cells, frames)
        sizes = dict(zip(PARTS, shares, strict=True))
        parts = split_objects(features.object.tolist(), features.label.tolist(), sizes, split)
        settings = (VERSION, cells, frames, features.index.tolist())
        manifest = SampleSet.open(folder).manifest
        super().__init__(manifest, parts, settings, batch=batch, augment=augment, seed=seed)
        self.features, self.cells, self.frames = features, cells, frames

    @property
    def press_scale(self) -> list[float]:
        """Root mean square of the nonzero values of each press channel, over the training part."""
        begins = self.features.begins
        ranges = [np.arange(begins[i], begins[i + 1]) for i in self.parts["train"]]
        rows = np.concatenate([np.zeros(0, dtype=np.int64), *ranges])
        return _rms_per_channel(self.features.presses[rows])

    @property
    def shared_scale(self) -> list[float]:
        """Root mean square of the nonzero values of each channel of the object, likewise."""
        return _rms_per_channel(self.features.shared[self.parts["train"]])

    def sample(self, row: int, symmetry: Symmetry = IDENTITY, deviate: float = 0.0) -> Row:
        """Return presses, fields of the object, target and mask; `deviate` has no effect.

        The transformed object with its transformed presses is equally likely.
        """
        features = self.features
        begin, end = features.begins[row : row + 2]
        presses = torch.from_numpy(features.presses[begin:end]).float()
        others = (features.shared[row], features.target[row], features.inside[row])
        shared, target, inside = (apply_symmetry(symmetry, torch.from_numpy(f)) for f in others)
        presses = apply_symmetry(symmetry, presses, PRESS_VECTORS)
        return presses, shared.float(), target.float(), inside


def _rms_per_channel(fields: np.ndarray) -> list[float]:
    """Return the root mean square of the nonzero values of each channel; 1 if there are none."""
    scales = []
    for channel in np.moveaxis(fields, 1, 0):
        values = channel[channel != 0].astype(np.float64)
        scales.append(float(np.sqrt(np.mean(values**2))) if len(values) else 1.0)
    return scales

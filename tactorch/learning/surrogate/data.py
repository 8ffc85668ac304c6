"""Presses and truths to train a surrogate on."""

import json
from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path

import lightning
import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from tactorch.errors import ConfigError
from tactorch.generation import SampleSet
from tactorch.learning.order import EpochSampler
from tactorch.learning.splits import PARTS, split_objects
from tactorch.learning.surrogate.cache import Touches, load_touches
from tactorch.learning.surrogate.touch import PRESS_VECTORS, VERSION
from tactorch.learning.symmetry import IDENTITY, Symmetry, apply, symmetries

Row = tuple[Tensor, Tensor, Tensor, Tensor]


class Turned(Dataset[Row]):
    """Objects and their presses, all seen through a symmetry of the cube drawn in each epoch.

    A cube that is turned with all its presses is a cube as likely.

    Args:
        touches: All objects.
        places: Those of this part.
        allowed: Symmetries.
        seed: Of the draws.
    """

    def __init__(
        self, touches: Touches, places: Sequence[int], allowed: Sequence[Symmetry], seed: int
    ) -> None:
        self.touches, self.places = touches, list(places)
        self.allowed, self.seed = allowed, seed

    def __len__(self) -> int:
        return len(self.places)

    def __getitem__(self, when: tuple[int, int]) -> Row:
        """Return presses, shared fields, target and inside, for an epoch and a place."""
        epoch, place = when
        rng = np.random.default_rng([self.seed, epoch, place])
        symmetry = self.allowed[int(rng.integers(len(self.allowed)))]
        i = self.places[place]
        begin, end = self.touches.begins[i : i + 2]
        presses = torch.from_numpy(self.touches.presses[begin:end]).float()
        return (
            apply(symmetry, presses, PRESS_VECTORS),
            apply(symmetry, torch.from_numpy(self.touches.shared[i]).float()),
            apply(symmetry, torch.from_numpy(self.touches.target[i]).float()),
            apply(symmetry, torch.from_numpy(self.touches.inside[i])),
        )


def batched(rows: Sequence[Row]) -> list[Tensor]:
    """Return presses (padded with zeros), which are there, shared fields, targets, insides."""
    most = max(len(presses) for presses, *_ in rows)
    counts = torch.tensor([len(presses) for presses, *_ in rows])
    padded = rows[0][0].new_zeros((len(rows), most, *rows[0][0].shape[1:]))
    for out, (presses, *_) in zip(padded, rows, strict=True):
        out[: len(presses)] = presses
    there = torch.arange(most)[None] < counts[:, None]
    others = [torch.stack(parts) for parts in list(zip(*rows, strict=True))[1:]]
    return [padded, there, *others]


class SurrogateData(lightning.LightningDataModule):
    """Presses and true log-moduli on a grid.

    What the network sees of each sample is worked out once and kept in the dataset's folder. Its
    `fingerprint` tells data and split from others.

    Args:
        folder: Dataset, such as `tactorch generate dataset=warmstart` makes.
        cells: In each direction, of what is seen; targets have twice as many.
        frames: Load steps of each place to look at.
        batch: Objects in a batch.
        shares: Of the objects in training, validation and test.
        split: Seed of the split.
        augment: Whether training objects are turned and mirrored with their presses.
        seed: Of order and augmentation.

    Raises:
        FileError: The dataset is missing or damaged.
        ConfigError: A setting cannot be used.
    """

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
        super().__init__()
        if batch < 1 or split < 0 or seed < 0:
            raise ConfigError("batch must be at least 1, split and seed at least 0.")
        if cells < 4 or cells % 2:
            raise ConfigError(f"cells={cells} must be even, and at least 4.")
        self.cells, self.frames, self.batch = cells, frames, batch
        self.augment, self.seed = augment, seed
        self.touches = load_touches(folder, cells, frames)
        objects, labels = self.touches.object.tolist(), self.touches.label.tolist()
        sizes = dict(zip(PARTS, shares, strict=True))
        self.parts = split_objects(objects, labels, sizes, split)
        self.numbers = self.touches.index.tolist()
        shards = [shard["sha256"] for shard in SampleSet.open(folder).manifest["shards"]]
        content = [shards, VERSION, cells, frames, self.numbers, self.parts]
        self.fingerprint = sha256(json.dumps(content).encode()).hexdigest()

    @property
    def press_scale(self) -> list[float]:
        """Root mean square of each press channel where it is not zero, over the training part."""
        part = self.parts["train"]
        ranges = [range(*self.touches.begins[i : i + 2]) for i in part]
        rows = np.array([place for one in ranges for place in one], dtype=np.int64)
        return _sizes(self.touches.presses[rows])

    @property
    def shared_scale(self) -> list[float]:
        """The same of the object's channels."""
        return _sizes(self.touches.shared[self.parts["train"]])

    def train_dataloader(self) -> DataLoader:
        """Return shuffled batches, augmented."""
        allowed = symmetries(np.zeros((0, 3))) if self.augment else [IDENTITY]
        rows = Turned(self.touches, self.parts["train"], allowed, self.seed)
        order = EpochSampler(len(rows), self.seed)
        last = len(rows) > self.batch
        return DataLoader(rows, self.batch, sampler=order, drop_last=last, collate_fn=batched)

    def val_dataloader(self) -> DataLoader:
        """Return the validation batches."""
        return self.loader("val")

    def test_dataloader(self) -> DataLoader:
        """Return the test batches."""
        return self.loader("test")

    def predict_dataloader(self) -> DataLoader:
        """Return the test batches."""
        return self.loader("test")

    def loader(self, part: str) -> DataLoader:
        """Return the batches of a part as they are, in order."""
        rows = Turned(self.touches, self.parts[part], [IDENTITY], self.seed)
        order = [(0, place) for place in range(len(rows))]
        return DataLoader(rows, self.batch, sampler=order, collate_fn=batched)


def _sizes(fields: np.ndarray) -> list[float]:
    """Root mean square of each channel's values that are not zero; 1 where all are."""
    found = []
    for channel in np.moveaxis(fields, 1, 0):
        values = channel[channel != 0].astype(np.float64)
        found.append(float(np.sqrt(np.mean(values**2))) if len(values) else 1.0)
    return found

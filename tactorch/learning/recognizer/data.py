"""SampleMaps and labels to train a recognizer on."""

import json
from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path
from typing import Literal

import lightning
import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, TensorDataset

from tactorch.errors import ConfigError
from tactorch.generation import SampleMaps, SampleSet
from tactorch.learning.order import EpochSampler
from tactorch.learning.splits import PARTS, split_objects
from tactorch.learning.symmetry import IDENTITY, Symmetry, apply, symmetries
from tactorch.mesh import VoxelGrid


class Turned(Dataset[tuple[Tensor, Tensor]]):
    """SampleMaps, each transformed by a random symmetry and factor in each epoch.

    Args:
        maps: (n, 1, v, v, v) log-modulus.
        labels: (n,).
        allowed: Symmetries.
        brightness: Standard deviation of what is added to the logarithm.
        seed: Of the draws.
    """

    def __init__(
        self,
        maps: Tensor,
        labels: Tensor,
        allowed: Sequence[Symmetry],
        brightness: float,
        seed: int,
    ) -> None:
        self.maps, self.labels, self.allowed = maps, labels, allowed
        self.brightness, self.seed = brightness, seed

    def __len__(self) -> int:
        return len(self.maps)

    def __getitem__(self, when: tuple[int, int]) -> tuple[Tensor, Tensor]:
        """Return a map and its label, for an epoch and a place."""
        epoch, place = when
        rng = np.random.default_rng([self.seed, epoch, place])
        chosen = self.allowed[int(rng.integers(len(self.allowed)))]
        factor = self.brightness * float(rng.standard_normal())
        return apply(chosen, self.maps[place]) + factor, self.labels[place]


class RecognitionData(lightning.LightningDataModule):
    """Log-modulus on a grid, and which inclusion it is.

    Its `fingerprint` tells data and split from others.

    Args:
        folder: Dataset, such as `tactorch generate dataset=recognition` makes.
        voxels: In each direction.
        batch: SampleMaps in a batch.
        shares: Of the objects in training, validation and test.
        split: Seed of the split.
        source: "reconstruction" or "truth".
        augment: Whether training maps are turned and mirrored as the presses allow, and made
            stiffer or softer as a whole.
        brightness: Standard deviation of that factor's logarithm.
        seed: Of order and augmentation.

    Raises:
        FileError: The dataset is missing or damaged.
        ConfigError: It has no reconstructions, or a setting cannot be used.
    """

    def __init__(
        self,
        folder: str | Path,
        *,
        voxels: int = 24,
        batch: int = 16,
        shares: tuple[float, float, float] = (0.7, 0.1, 0.2),
        split: int = 0,
        source: Literal["reconstruction", "truth"] = "reconstruction",
        augment: bool = True,
        brightness: float = 0.1,
        seed: int = 0,
    ) -> None:
        super().__init__()
        if source not in ("reconstruction", "truth"):
            raise ConfigError(f"source={source!r}: choose reconstruction or truth.")
        if batch < 1 or voxels < 1 or split < 0 or seed < 0:
            raise ConfigError("batch and voxels must be at least 1, split and seed at least 0.")
        self.voxels, self.batch, self.source = voxels, batch, source
        self.augment, self.brightness, self.seed = augment, brightness, seed
        found = SampleSet.open(folder)
        found.verify()
        samples = [found.maps(index) for index in found.indices]
        if not samples:
            raise ConfigError(f"dataset '{folder}' is empty.")
        self.classes = sorted({sample.label for sample in samples})
        grids = {sample.mesh: VoxelGrid(sample.mesh, voxels) for sample in samples}
        self.maps = torch.stack([self._map(sample, grids[sample.mesh]) for sample in samples])
        self.labels = torch.tensor([self.classes.index(sample.label) for sample in samples])
        self.numbers = [sample.index for sample in samples]
        self.parts = split_objects(
            [sample.object for sample in samples],
            [sample.label for sample in samples],
            dict(zip(PARTS, shares, strict=True)),
            split,
        )
        self.allowed = _common_symmetries(samples)
        shards = [shard["sha256"] for shard in found.manifest["shards"]]
        self.fingerprint = sha256(json.dumps([shards, self.parts]).encode()).hexdigest()

    @property
    def mean(self) -> float:
        """Of the training maps; 0 where there are none, for data that are only judged."""
        maps = self.maps[self.parts["train"]]
        return float(maps.mean()) if len(maps) else 0.0

    @property
    def deviation(self) -> float:
        """Standard deviation of the training maps; 1 where there are none."""
        maps = self.maps[self.parts["train"]]
        return float(maps.std()) if len(maps) else 1.0

    def train_dataloader(self) -> DataLoader:
        """Return shuffled batches, augmented."""
        places = self.parts["train"]
        allowed = self.allowed if self.augment else [IDENTITY]
        brightness = self.brightness if self.augment else 0.0
        maps = Turned(self.maps[places], self.labels[places], allowed, brightness, self.seed)
        order = EpochSampler(len(maps), self.seed)
        return DataLoader(maps, self.batch, sampler=order, drop_last=len(maps) > self.batch)

    def val_dataloader(self) -> DataLoader:
        """Return the validation batches."""
        return DataLoader(self._part("val"), self.batch)

    def test_dataloader(self) -> DataLoader:
        """Return the test batches."""
        return DataLoader(self._part("test"), self.batch)

    def predict_dataloader(self) -> DataLoader:
        """Return the test batches."""
        return self.test_dataloader()

    def _part(self, name: str) -> TensorDataset:
        places = self.parts[name]
        return TensorDataset(self.maps[places], self.labels[places])

    def _map(self, sample: SampleMaps, grid: VoxelGrid) -> Tensor:
        youngs = sample.truth if self.source == "truth" else sample.reconstruction
        if youngs is None:
            raise ConfigError(
                "the dataset has no reconstructions; generate it with dataset.reconstruct=true, or"
                " learn from data.source=truth."
            )
        return torch.from_numpy(np.log(grid.fill(youngs))).float()[None]


def _common_symmetries(samples: Sequence[SampleMaps]) -> list[Symmetry]:
    """What keeps the pressed sides of every sample as they are; at least: nothing."""
    if any(sample.pushes is None for sample in samples):
        return [IDENTITY]
    sets = [symmetries(sample.pushes) for sample in samples if sample.pushes is not None]
    return [one for one in sets[0] if all(one in others for others in sets[1:])]

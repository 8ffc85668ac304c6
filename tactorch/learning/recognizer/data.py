"""Maps and labels for the training of a recognizer."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from tactorch.errors import ConfigError
from tactorch.generation import SampleMaps, SampleSet
from tactorch.learning.data import (
    IDENTITY,
    PARTS,
    SplitData,
    Symmetry,
    apply_symmetry,
    split_objects,
    symmetries,
)
from tactorch.mesh import VoxelGrid


class RecognitionData(SplitData):
    """Log-modulus on a grid and the class of the inclusion.

    Args:
        folder: Dataset, such as of `tactorch generate dataset=recognition`.
        voxels: Voxels in each direction.
        batch: Maps per batch.
        shares: Fractions of the objects in training, validation and test.
        split: Seed of the split.
        source: Maps to use, "reconstruction" or "truth".
        augment: Whether to rotate and mirror training maps, as the presses allow, and to scale
            their modulus.
        brightness: Standard deviation of the logarithm of that scale.
        seed: Seed of order and augmentation.

    Raises:
        FileError: The dataset is missing or damaged.
        ConfigError: The dataset has no reconstructions, or a setting is not valid.
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
        if source not in ("reconstruction", "truth"):
            raise ConfigError(f"source={source!r}: choose reconstruction or truth.")
        if batch < 1 or voxels < 1 or split < 0 or seed < 0:
            raise ConfigError("batch and voxels must be at least 1, split and seed at least 0.")
        dataset = SampleSet.open(folder)
        dataset.verify()
        samples = [dataset.maps(index) for index in dataset.indices]
        if not samples:
            raise ConfigError(f"dataset '{folder}' is empty.")
        objects, labels = [s.object for s in samples], [s.label for s in samples]
        sizes = dict(zip(PARTS, shares, strict=True))
        grids = {sample.mesh: VoxelGrid(sample.mesh, voxels) for sample in samples}
        maps = [_log_map(sample, source, grids[sample.mesh]) for sample in samples]
        parts = split_objects(objects, labels, sizes, split)
        super().__init__(dataset.manifest, parts, batch=batch, augment=augment, seed=seed)
        self.maps, self.brightness = torch.stack(maps), brightness
        self.classes = sorted(set(labels))
        self.labels = torch.tensor([self.classes.index(label) for label in labels])
        self.allowed = _common_symmetries(samples)

    @property
    def mean(self) -> float:
        """Mean of the training maps; 0 if there are none, as in data that are only evaluated."""
        maps = self.maps[self.parts["train"]]
        return float(maps.mean()) if len(maps) else 0.0

    @property
    def deviation(self) -> float:
        """Standard deviation of the training maps; 1 if there are none."""
        maps = self.maps[self.parts["train"]]
        return float(maps.std()) if len(maps) else 1.0

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
    """Return the symmetries that keep the pressed sides of every sample."""
    if any(sample.pushes is None for sample in samples):
        return [IDENTITY]
    sets = [symmetries(sample.pushes) for sample in samples if sample.pushes is not None]
    return [symmetry for symmetry in sets[0] if all(symmetry in other for other in sets[1:])]

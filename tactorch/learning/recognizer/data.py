"""Maps and labels for the training of a recognizer."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from torch import Tensor

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
from tactorch.mesh import VoxelGrid


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
        dataset = SampleSet.open(options.folder)
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
    """Return the symmetries that keep the pressed sides of every sample."""
    if any(sample.pushes is None for sample in samples):
        return [IDENTITY]
    sets = [symmetries(sample.pushes) for sample in samples if sample.pushes is not None]
    return [symmetry for symmetry in sets[0] if all(symmetry in other for other in sets[1:])]

"""Features and true maps for the training of a surrogate, cached in the folder of the dataset."""

import json
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float16
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from tactorch.config import option
from tactorch.errors import ConfigError, ConvergenceError, FileError
from tactorch.files import read_arrays, write_arrays
from tactorch.generation import SampleSet
from tactorch.learning.data import (
    IDENTITY,
    DataOptions,
    SplitData,
    Symmetry,
    apply_symmetry,
    symmetries,
)
from tactorch.learning.surrogate.features import (
    PRESS_VECTORS,
    VERSION,
    compute_features,
    compute_targets,
)
from tactorch.processes import run_in_processes, single_thread

_log = logging.getLogger(__name__)
FOLDER = "touch"  # of cached features, in existing datasets
_SCALARS = ("index", "object", "label", "youngs_mpa")
_GRIDS = ("shared", "target", "inside")
Row = tuple[Tensor, Tensor, Tensor, Tensor]


def collate(rows: Sequence[Row]) -> list[Tensor]:
    """Return presses (padded with zeros), their mask, fields of the objects, targets and masks."""
    presses, *others = zip(*rows, strict=True)
    masks = [torch.ones(len(one), dtype=torch.bool) for one in presses]
    padded, mask = (pad_sequence([*parts], batch_first=True) for parts in (presses, masks))
    return [padded, mask, *map(torch.stack, others)]


@dataclass(frozen=True, kw_only=True)
class SurrogateDataOptions(DataOptions):
    """Presses and true log-moduli on a grid."""

    folder: Path = option(help="Dataset, such as of `tactorch generate dataset=warmstart`")
    cells: int = option(
        8, "Cells of the features in each direction, even; targets have twice as many", ge=4
    )
    frames: int = option(1, "Load steps to use per press location", ge=1)
    shares: tuple[float, float, float] = option(
        (0.9, 0.05, 0.05), "Fractions of the objects in training, validation and test"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.cells % 2:
            raise ConfigError(f"data.cells={self.cells}: give an even number.")

    def __call__(self, *, seed: int) -> "SurrogateData":
        """Return the data module."""
        return SurrogateData(self, seed)


class SurrogateData(SplitData):
    """Presses and true log-moduli on a grid.

    The features are computed once and cached in the folder of the dataset. `FileError` is raised if
    the dataset is missing or damaged. `seed` is that of order and augmentation.
    """

    collate = staticmethod(collate)
    allowed = symmetries(np.zeros((0, 3)))

    def __init__(self, options: SurrogateDataOptions, seed: int = 0) -> None:
        folder, cells, frames = options.folder, options.cells, options.frames
        features = load_features(folder, cells, frames)
        objects, labels = [f.object for f in features], [f.label for f in features]
        settings = (VERSION, cells, frames, [f.index for f in features])
        super().__init__(options, seed, SampleSet(folder).manifest, objects, labels, settings)
        self.features, self.cells, self.frames = features, cells, frames

    @property
    def press_scale(self) -> list[float]:
        """Root mean square of the nonzero values of each press channel, over the training part."""
        presses = [self.features[row].presses for row in self.parts["train"]]
        return _rms_per_channel(np.concatenate(presses))

    @property
    def shared_scale(self) -> list[float]:
        """Root mean square of the nonzero values of each channel of the object, likewise."""
        return _rms_per_channel(np.stack([self.features[r].shared for r in self.parts["train"]]))

    def sample(self, row: int, symmetry: Symmetry = IDENTITY, deviate: float = 0.0) -> Row:
        """Return presses, fields of the object, target and mask; `deviate` has no effect.

        The transformed object with its transformed presses is equally likely.
        """
        features = self.features[row]
        presses = torch.from_numpy(features.presses).float()
        others = (features.shared, features.target, features.inside)
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


@dataclass(frozen=True, eq=False)
class SampleFeatures:
    """Features and targets of a sample, in half precision.

    `target` is the logarithm of the true modulus relative to the best uniform one, `youngs_mpa`;
    `inside` are the voxels in the body.
    """

    index: int
    object: int
    label: str
    youngs_mpa: float
    shared: Float16[np.ndarray, "s v v v"]
    target: Float16[np.ndarray, "w w w"]
    inside: Bool[np.ndarray, "w w w"]
    presses: Float16[np.ndarray, "k c v v v"]


def load_features(
    folder: str | Path, count: int = 8, frames: int = 1, workers: int | None = None
) -> list[SampleFeatures]:
    """Return the features of the samples of a dataset; missing ones are computed and cached.

    Samples without an equilibrium at any uniform modulus are omitted with a warning.

    Features have `count` cells in each direction, targets twice as many; `frames` are the load
    steps to use per press location.
    """
    samples = SampleSet(folder)
    samples.verify()
    features: list[SampleFeatures] = []
    shards = samples.manifest["shards"]
    for number, shard in enumerate(shards):
        settings = json.dumps([VERSION, shard["sha256"], count, frames])
        key = sha256(settings.encode()).hexdigest()[:16]
        path = samples.folder / FOLDER / f"{number:05d}-{key}.npz"
        part = _read(path)
        if part is None:
            _log.info("shard %d of %d: computing features", number + 1, len(shards))
            end = shard["first"] + shard["count"]
            indices = [i for i in samples.indices if shard["first"] <= i < end]
            part = _compute_part(samples, indices, count, frames, workers)
            _write(path, part)
        features += part
    if not features:
        raise FileError(f"dataset '{folder}' has no sample in equilibrium with a uniform modulus.")
    omitted = len(samples) - len(features)
    if omitted:
        text = "%d of %d samples omitted: no equilibrium with a uniform modulus"
        _log.warning(text, omitted, len(samples))
    return features


def _compute_part(
    samples: SampleSet, indices: Sequence[int], count: int, frames: int, workers: int | None
) -> list[SampleFeatures]:
    compute = partial(_compute_row, samples, count, frames)
    rows = run_in_processes(compute, indices, workers)
    return sorted((row for row in rows if row), key=lambda row: row.index)


def _compute_row(samples: SampleSet, count: int, frames: int, index: int) -> SampleFeatures | None:
    """Return the features of one sample; None without an equilibrium at any uniform modulus."""
    sample = samples[index]
    with single_thread():
        try:
            youngs_mpa, *fields = compute_features(sample.recording, count, frames)
        except ConvergenceError:
            return None
    presses, shared = (field.astype(np.float16) for field in fields)
    target, inside = compute_targets(sample.recording.mesh, sample.truth, youngs_mpa, 2 * count)
    names = sample.index, sample.object, sample.label
    return SampleFeatures(*names, youngs_mpa, shared, target.astype(np.float16), inside, presses)


def _write(path: Path, part: Sequence[SampleFeatures]) -> None:
    """Write a part as one array of each field, and the first press of each sample as `begins`."""
    arrays = {name: np.array([getattr(row, name) for row in part]) for name in (*_SCALARS, *_GRIDS)}
    arrays["presses"] = np.concatenate([row.presses for row in part]) if part else np.zeros(0)
    arrays["begins"] = np.cumsum([0, *(len(row.presses) for row in part)])
    try:
        write_arrays(path, arrays, compressed=True)
    except FileError as error:  # a dataset may be read-only
        _log.warning("The features are not cached: %s", error)


def _read(path: Path) -> list[SampleFeatures] | None:
    """Return a cached part; None where it is missing or not valid."""
    try:
        arrays = read_arrays(path, "cached features", "they are computed again.")
        presses, begins = arrays["presses"], arrays["begins"].tolist()
        if begins[-1] != len(presses):
            return None
        parts = [presses[begin:end] for begin, end in pairwise(begins)]
        scalars = [arrays[name].tolist() for name in _SCALARS]
        rows = zip(*scalars, *(arrays[name] for name in _GRIDS), parts, strict=True)
        return [SampleFeatures(*row) for row in rows]
    except (FileError, LookupError, TypeError, ValueError):
        return None

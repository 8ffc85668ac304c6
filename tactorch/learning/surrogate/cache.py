"""Features of a dataset, computed once and cached in its folder."""

import json
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Float16, Int, Shaped

from tactorch.errors import ConvergenceError, FileError
from tactorch.files import read_arrays, write_arrays
from tactorch.generation import SampleSet
from tactorch.learning.surrogate.features import (
    PRESS_CHANNELS,
    SHARED_CHANNELS,
    VERSION,
    compute_features,
    compute_targets,
)
from tactorch.processes import single_thread

_log = logging.getLogger(__name__)
FOLDER = "touch"  # name in existing datasets


@dataclass(frozen=True, eq=False)
class FeatureSet:
    """Features and targets of n samples, in half precision.

    Attributes:
        index: Index of each sample in the dataset.
        object: Number of the object of each sample.
        label: Label of each sample.
        youngs_mpa: Best uniform modulus of each sample, MPa.
        presses: Features of the presses of all samples, concatenated.
        begins: Index of the first press of each sample, and the number of presses.
        shared: Features of the object of each sample.
        target: Logarithm of the true modulus relative to the uniform one.
        inside: Whether a voxel is in the body.
    """

    index: Int[np.ndarray, " n"]
    object: Int[np.ndarray, " n"]
    label: Shaped[np.ndarray, " n"]
    youngs_mpa: Float[np.ndarray, " n"]
    presses: Float16[np.ndarray, "total c v v v"]
    begins: Int[np.ndarray, " n_plus_1"]
    shared: Float16[np.ndarray, "n s v v v"]
    target: Float16[np.ndarray, "n w w w"]
    inside: Bool[np.ndarray, "n w w w"]

    def __len__(self) -> int:
        return len(self.index)

    @property
    def is_consistent(self) -> bool:
        """Whether the sizes of the arrays agree."""
        n = len(self.index)
        parts = (self.object, self.label, self.youngs_mpa, self.shared, self.target, self.inside)
        fit = all(len(part) == n for part in parts) and len(self.begins) == n + 1
        return fit and int(self.begins[-1]) == len(self.presses)

    @staticmethod
    def empty(count: int) -> "FeatureSet":
        """Return a set of no samples on grids of `count` cells."""
        coarse, fine = (count,) * 3, (0, *(2 * count,) * 3)
        integers = np.zeros(0, np.int64)
        return FeatureSet(
            integers,
            integers,
            np.zeros(0, np.str_),
            np.zeros(0),
            np.zeros((0, len(PRESS_CHANNELS), *coarse), np.float16),
            np.zeros(1, np.int64),
            np.zeros((0, len(SHARED_CHANNELS), *coarse), np.float16),
            np.zeros(fine, np.float16),
            np.zeros(fine, np.bool_),
        )

    @staticmethod
    def concatenate(parts: Sequence["FeatureSet"]) -> "FeatureSet":
        """Return the samples of several sets as one."""
        names = ("index", "object", "label", "youngs_mpa", "presses", "shared", "target", "inside")
        fields = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
        counts = np.concatenate([np.diff(part.begins) for part in parts])
        return FeatureSet(begins=np.concatenate([[0], np.cumsum(counts)]), **fields)


def load_features(
    folder: str | Path, count: int = 8, frames: int = 1, workers: int | None = None
) -> FeatureSet:
    """Return the features of a dataset; missing ones are computed and cached.

    Samples without an equilibrium at any uniform modulus are omitted with a warning.

    Features have `count` cells in each direction, targets twice as many; `frames` are the load
    steps to use per press location.

    Raises:
        FileError: The dataset is missing or damaged, or all samples were omitted.
    """
    samples = SampleSet.open(folder)
    samples.verify()
    parts = []
    shards = samples.manifest["shards"]
    for number, shard in enumerate(shards):
        path = samples.folder / FOLDER / f"{number:05d}-{_key(shard['sha256'], count, frames)}.npz"
        part = _read(path)
        if part is None:
            _log.info("shard %d of %d: computing features", number + 1, len(shards))
            end = shard["first"] + shard["count"]
            indices = [i for i in samples.indices if shard["first"] <= i < end]
            part = _compute_part(samples, indices, count, frames, workers)
            _write(path, part)
        parts.append(part)
    features = FeatureSet.concatenate(parts)
    if not len(features):
        raise FileError(f"dataset '{folder}' has no sample in equilibrium with a uniform modulus.")
    omitted = len(samples) - len(features)
    if omitted:
        text = "%d of %d samples omitted: no equilibrium with a uniform modulus"
        _log.warning(text, omitted, len(samples))
    return features


def _key(checksum: str, count: int, frames: int) -> str:
    return sha256(json.dumps([VERSION, checksum, count, frames]).encode()).hexdigest()[:16]


def _compute_part(
    samples: SampleSet, indices: Sequence[int], count: int, frames: int, workers: int | None
) -> FeatureSet:
    from joblib import Parallel, delayed, parallel_config

    with parallel_config(backend="loky", inner_max_num_threads=1):
        rows = Parallel(n_jobs=workers or -1)(
            delayed(_compute_row)(samples, index, count, frames) for index in indices
        )
    return FeatureSet.concatenate([FeatureSet.empty(count), *(row for row in rows if row)])


def _compute_row(samples: SampleSet, index: int, count: int, frames: int) -> FeatureSet | None:
    """Return the features of one sample; None without an equilibrium at any uniform modulus."""
    sample = samples[index]
    with single_thread():
        try:
            features = compute_features(sample.recording, count, frames)
        except ConvergenceError:
            return None
    mesh, youngs_mpa = sample.recording.mesh, features.youngs_mpa
    target, inside = compute_targets(mesh, sample.truth, youngs_mpa, 2 * count)
    return FeatureSet(
        np.array([sample.index]),
        np.array([sample.object]),
        np.array([sample.label]),
        np.array([youngs_mpa]),
        features.presses.astype(np.float16),
        np.array([0, len(features.presses)]),
        features.shared.astype(np.float16)[None],
        target.astype(np.float16)[None],
        inside[None],
    )


def _write(path: Path, part: FeatureSet) -> None:
    try:
        write_arrays(path, vars(part), compressed=True)
    except FileError as error:  # a dataset may be read-only
        _log.warning("The features are not cached: %s", error)


def _read(path: Path) -> FeatureSet | None:
    """Return a cached part; None where it is missing or not valid."""
    try:
        part = FeatureSet(**read_arrays(path, "cached features", "they are computed again."))
    except (FileError, TypeError):
        return None
    return part if part.is_consistent else None

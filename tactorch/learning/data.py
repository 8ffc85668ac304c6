"""Splits by object, order and augmentation of the samples, and the base of the data modules."""

import json
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from itertools import permutations, product
from pathlib import Path
from typing import Any, ClassVar

import lightning
import numpy as np
from jaxtyping import Float
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, Sampler

from tactorch.config import Options, option
from tactorch.errors import ConfigError

PARTS = ("train", "val", "test")
#: Order of the axes and sign of each: axis i of the image is axis `order[i]` times `signs[i]`.
Symmetry = tuple[tuple[int, int, int], tuple[int, int, int]]
IDENTITY: Symmetry = ((0, 1, 2), (1, 1, 1))


@dataclass(frozen=True, kw_only=True)
class DataOptions(Options):
    """Settings of a data module; calling them with `seed=` makes it."""

    section: ClassVar[str] = "data"
    folder: Path = option(help="Dataset of `tactorch generate`")
    batch: int = option(16, "Samples per batch", ge=1)
    shares: tuple[float, float, float] = option(
        (0.7, 0.1, 0.2), "Fractions of the objects in training, validation and test"
    )
    split: int = option(0, "Seed of the split", ge=0)
    augment: bool = option(True, "Whether to rotate and mirror training samples with their presses")


class SplitData(lightning.LightningDataModule):
    """Data module of a dataset whose samples are split by object.

    `objects` and `labels` are those of the samples. `settings` are plain values that determine the
    samples besides the dataset and the parts. `seed` is that of order and augmentation. The
    attribute `fingerprint` identifies the data and the split.
    """

    #: Function that makes a batch of samples; torch's if None.
    collate: Callable[[Any], Any] | None = None
    #: Symmetries of the augmentation.
    allowed: Sequence[Symmetry] = (IDENTITY,)

    def __init__(
        self,
        options: DataOptions,
        seed: int,
        manifest: Mapping[str, Any],
        objects: Sequence[int],
        labels: Sequence[str],
        settings: Sequence[Any] = (),
    ) -> None:
        super().__init__()
        self.options, self.seed = options, seed
        sizes = dict(zip(PARTS, options.shares, strict=True))
        self.parts = split_objects(objects, labels, sizes, options.split)
        shards = [shard["sha256"] for shard in manifest["shards"]]
        self.fingerprint = sha256(json.dumps([shards, *settings, self.parts]).encode()).hexdigest()

    @abstractmethod
    def sample(self, row: int, symmetry: Symmetry = IDENTITY, deviate: float = 0.0) -> Any:
        """Return a sample, transformed by a symmetry and a standard normal random number."""

    def loader(self, part: str) -> DataLoader:
        """Return the batches of a part, in order and without augmentation."""
        rows = self.parts[part]
        order = [(0, position) for position in range(len(rows))]
        data = AugmentedSamples(self, rows, augment=False)
        return DataLoader(data, self.options.batch, sampler=order, collate_fn=self.collate)

    def train_dataloader(self) -> DataLoader:
        """Return shuffled batches, augmented if this is set."""
        rows, batch = self.parts["train"], self.options.batch
        order, drop = EpochSampler(len(rows), self.seed), len(rows) > batch
        data = AugmentedSamples(self, rows, self.options.augment)
        return DataLoader(data, batch, sampler=order, drop_last=drop, collate_fn=self.collate)

    def val_dataloader(self) -> DataLoader:
        """Return the validation batches."""
        return self.loader("val")

    def test_dataloader(self) -> DataLoader:
        """Return the test batches."""
        return self.loader("test")

    predict_dataloader = test_dataloader


class AugmentedSamples(Dataset[Any]):
    """Samples in `rows` of a data module; augmented ones differ in each epoch."""

    def __init__(self, data: SplitData, rows: Sequence[int], augment: bool) -> None:
        self.data, self.rows, self.augment = data, rows, augment

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, item: tuple[int, int]) -> Any:
        """Return a sample by epoch and position in `rows`."""
        epoch, index = item
        if not self.augment:
            return self.data.sample(self.rows[index])
        rng, allowed = np.random.default_rng([self.data.seed, epoch, index]), self.data.allowed
        symmetry = allowed[int(rng.integers(len(allowed)))]
        return self.data.sample(self.rows[index], symmetry, float(rng.standard_normal()))


class EpochSampler(Sampler[tuple[int, int]]):
    """Shuffles `count` samples in an order that depends only on the seed and the epoch.

    Yields pairs (epoch, index), for datasets whose augmentation depends on both. Lightning sets
    the epoch.
    """

    def __init__(self, count: int, seed: int = 0) -> None:
        self.count, self.seed, self.epoch = count, seed, 0

    def set_epoch(self, epoch: int) -> None:
        """Set the number of the next epoch."""
        self.epoch = epoch

    def __len__(self) -> int:
        return self.count

    def __iter__(self) -> Iterator[tuple[int, int]]:
        order = np.random.default_rng([self.seed, self.epoch]).permutation(self.count)
        return iter([(self.epoch, int(index)) for index in order])


def split_objects(
    objects: Sequence[int], labels: Sequence[str], sizes: Mapping[str, float], seed: int = 0
) -> dict[str, list[int]]:
    """Split samples by object, stratified by label: samples of an object are in the same part.

    `sizes` are the fractions of the objects in each part. Returns indices of the samples of each
    part, ascending.
    """
    if abs(sum(sizes.values()) - 1.0) > 1e-9 or min(sizes.values()) < 0:
        raise ConfigError(f"shares {dict(sizes)} must be positive and add up to 1.")
    label_of = dict(zip(objects, labels, strict=True))
    rng = np.random.default_rng(seed)
    ordered: list[tuple[float, int]] = []
    for label in sorted(set(label_of.values())):
        group = rng.permutation(sorted(n for n, other in label_of.items() if other == label))
        # Evenly spaced positions in [0, 1) per label: each part gets its fraction of every label.
        positions = (np.arange(len(group)) + rng.random()) / len(group)
        ordered += list(zip(positions.tolist(), group.tolist(), strict=True))
    ordered.sort()
    ends = np.cumsum(_counts(list(sizes.values()), len(ordered)))
    parts = {}
    for name, begin, end in zip(sizes, [0, *ends[:-1]], ends, strict=True):
        members = {number for _, number in ordered[begin:end]}
        if sizes[name] > 0 and not members:
            raise ConfigError(
                f"part '{name}' ({sizes[name]:.0%}) of {len(ordered)} objects is empty; generate"
                " more, or give it a larger share."
            )
        parts[name] = [index for index, number in enumerate(objects) if number in members]
    return parts


def _counts(shares: list[float], total: int) -> list[int]:
    """Distribute a total by largest remainder; parts with a positive share get at least one."""
    exact = [share * total for share in shares]
    counts = [int(np.floor(value + 1e-9)) for value in exact]
    by_remainder = np.argsort([count - value for count, value in zip(counts, exact, strict=True)])
    for part in by_remainder[: total - sum(counts)]:
        counts[int(part)] += 1
    for part, share in enumerate(shares):
        if share > 0 and counts[part] == 0 and max(counts) > 1:
            counts[int(np.argmax(counts))] -= 1
            counts[part] = 1
    return counts


def symmetries(directions: Float[np.ndarray, "k 3"]) -> list[Symmetry]:
    """Return the symmetries of the cube that keep a set of push directions along its axes.

    The transformed object is equally likely and pressed from the same sides.
    """
    pushed = {tuple(np.round(d).astype(int).tolist()) for d in directions}
    return [
        (order, signs)  # type: ignore[misc]
        for order, signs in product(permutations(range(3)), product((1, -1), repeat=3))
        if {tuple(s * d[o] for o, s in zip(order, signs, strict=True)) for d in pushed} == pushed
    ]


def apply_symmetry(symmetry: Symmetry, field: Tensor, vectors: Sequence[int] = ()) -> Tensor:
    """Return fields on a cubic grid, (..., channels, v, v, v), transformed by a symmetry.

    The components of vector fields, given by their first channels, are transformed as well.
    """
    order, signs = symmetry
    lead = field.dim() - 3
    image = field.permute(*range(lead), *(lead + axis for axis in order))
    flipped = [lead + axis for axis, sign in enumerate(signs) if sign < 0]
    image = image.flip(flipped) if flipped else image
    if not vectors:
        return image
    rotated = image.clone()
    for first in vectors:
        for axis, (source, sign) in enumerate(zip(order, signs, strict=True)):
            rotated[..., first + axis, :, :, :] = sign * image[..., first + source, :, :, :]
    return rotated

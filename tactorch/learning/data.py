"""Splits by object, order of the samples, and the base class of the data modules."""

from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence

import lightning
import numpy as np
from torch.utils.data import DataLoader, Sampler

from tactorch.errors import ConfigError

PARTS = ("train", "val", "test")


class SplitData(lightning.LightningDataModule):
    """Data module whose parts are loaded by `loader`, in order and without augmentation."""

    @abstractmethod
    def loader(self, part: str) -> DataLoader:
        """Return the batches of a part, in order and without augmentation."""

    def val_dataloader(self) -> DataLoader:
        """Return the validation batches."""
        return self.loader("val")

    def test_dataloader(self) -> DataLoader:
        """Return the test batches."""
        return self.loader("test")

    def predict_dataloader(self) -> DataLoader:
        """Return the test batches."""
        return self.loader("test")


class EpochSampler(Sampler[tuple[int, int]]):
    """Shuffles samples in an order that depends only on the seed and the epoch.

    Yields pairs (epoch, index), for datasets whose augmentation depends on both. Lightning sets
    the epoch.

    Args:
        count: Number of samples.
        seed: Seed of the orders.
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
    objects: Sequence[int],
    labels: Sequence[str],
    sizes: Mapping[str, float],
    seed: int = 0,
) -> dict[str, list[int]]:
    """Split samples by object, stratified by label: samples of an object are in the same part.

    Args:
        objects: Number of the object of each sample.
        labels: Label of each sample.
        sizes: Fraction of the objects in each part; the sum is 1.
        seed: Seed of the shuffling.

    Returns:
        Indices of the samples of each part, ascending.

    Raises:
        ConfigError: The fractions do not add up to 1, or a part is empty.
    """
    if abs(sum(sizes.values()) - 1.0) > 1e-9 or min(sizes.values()) < 0:
        raise ConfigError(f"shares {dict(sizes)} must be positive and add up to 1.")
    label_of = dict(zip(objects, labels, strict=True))
    rng = np.random.default_rng(seed)
    parts: dict[str, set[int]] = {name: set() for name in sizes}
    ordered = []
    for label in sorted(set(label_of.values())):
        group = sorted(number for number, other in label_of.items() if other == label)
        shuffled = rng.permutation(group)
        # Evenly spaced positions in [0, 1) per label: each part gets its fraction of every label.
        positions = (np.arange(len(group)) + rng.random()) / len(group)
        ordered += list(zip(positions.tolist(), shuffled.tolist(), strict=True))
    ordered.sort()
    ends = np.cumsum(_counts(list(sizes.values()), len(ordered)))
    for name, begin, end in zip(sizes, [0, *ends[:-1]], ends, strict=True):
        parts[name] = {number for _, number in ordered[begin:end]}
        if sizes[name] > 0 and not parts[name]:
            raise ConfigError(
                f"part '{name}' ({sizes[name]:.0%}) of {len(ordered)} objects is empty; generate"
                " more, or give it a larger share."
            )
    return {
        name: [index for index, number in enumerate(objects) if number in members]
        for name, members in parts.items()
    }


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

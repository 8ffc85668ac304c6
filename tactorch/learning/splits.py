"""Fixed splits by object: all recordings of an object belong to one part."""

from collections.abc import Mapping, Sequence

import numpy as np

from tactorch.errors import ConfigError

PARTS = ("train", "val", "test")


def split_objects(
    objects: Sequence[int],
    labels: Sequence[str],
    sizes: Mapping[str, float],
    seed: int = 0,
) -> dict[str, list[int]]:
    """Split samples by the object that they show, with the labels in each part as in the whole.

    Args:
        objects: Number of the object of each sample.
        labels: Label of each sample.
        sizes: Share of the objects in each part; they add up to 1.
        seed: Of the shuffling.

    Returns:
        For each part the places (not the numbers) of its samples, ascending.

    Raises:
        ConfigError: Shares do not add up to 1, or a part stays empty.
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
        # Even places in [0, 1) of each label: cuts at the shares then take their part of each.
        places = (np.arange(len(group)) + rng.random()) / len(group)
        ordered += list(zip(places.tolist(), shuffled.tolist(), strict=True))
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
        name: [place for place, number in enumerate(objects) if number in chosen]
        for name, chosen in parts.items()
    }


def _counts(shares: list[float], total: int) -> list[int]:
    """Share a number out: whole parts, then by the largest rests; nobody with a share gets none."""
    exact = [share * total for share in shares]
    counts = [int(np.floor(value + 1e-9)) for value in exact]
    rests = np.argsort([count - value for count, value in zip(counts, exact, strict=True)])
    for place in rests[: total - sum(counts)]:
        counts[int(place)] += 1
    for place, share in enumerate(shares):
        if share > 0 and counts[place] == 0 and max(counts) > 1:
            counts[int(np.argmax(counts))] -= 1
            counts[place] = 1
    return counts

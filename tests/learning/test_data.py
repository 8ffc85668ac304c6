from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactorch.errors import ConfigError
from tactorch.learning.data import split_objects

SHARES = {"train": 0.7, "val": 0.1, "test": 0.2}


@given(
    counts=st.lists(st.integers(8, 30), min_size=1, max_size=4),
    views=st.integers(1, 3),
    seed=st.integers(0, 2**32 - 1),
)
def test_objects_stand_on_one_side_and_labels_in_all(
    counts: list[int], views: int, seed: int
) -> None:
    labels = [
        f"kind {i}" for i, count in enumerate(counts) for _ in range(count) for _ in range(views)
    ]
    objects = [i // views for i in range(len(labels))]
    parts = split_objects(objects, labels, SHARES, seed)
    assert parts == split_objects(objects, labels, SHARES, seed)
    assert sorted(place for part in parts.values() for place in part) == list(range(len(labels)))
    sides = [{objects[place] for place in part} for part in parts.values()]
    assert sum(map(len, sides)) == len(set().union(*sides))
    for name, places in parts.items():
        assert abs(len(places) / views - SHARES[name] * sum(counts)) <= 1
        found = Counter(labels[place] for place in places)
        for i, count in enumerate(counts):
            assert abs(found[f"kind {i}"] / views - SHARES[name] * count) <= 2


def test_other_seeds_split_otherwise() -> None:
    labels = ["a", "b"] * 30
    splits = [split_objects(range(60), labels, SHARES, seed)["test"] for seed in range(5)]
    assert len({tuple(split) for split in splits}) == 5


@pytest.mark.parametrize(
    ("count", "sizes", "message"),
    [
        (10, {"train": 0.5, "test": 0.4}, "add up to 1"),
        (10, {"train": 1.5, "test": -0.5}, "positive"),
        (2, SHARES, "is empty"),
    ],
)
def test_impossible_splits_are_refused(count: int, sizes: dict, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        split_objects(range(count), ["a"] * count, sizes)

"""Regions from named groups of elements, of which some may contain or repeat others."""

import logging
from collections.abc import Mapping
from itertools import combinations

import numpy as np
from jaxtyping import Float, Int

from tactorch.errors import MeshError

_log = logging.getLogger(__name__)
_MOST = 100_000  # groups, which take seconds
_MANY = 10  # groups of which all combinations are tried
_SHOWN = 6  # groups that a message lists


def regions_of_groups(
    members: Mapping[int, Int[np.ndarray, " k"]],
    sizes: Float[np.ndarray, " e"],
    names: Mapping[int, str],
    source: object,
) -> Int[np.ndarray, " e"] | None:
    """Return the number of a group for each element, or for each set of elements.

    Of groups that contain one another, as that of the whole body and that of a lump, it is the
    smallest. Of groups that overlap, those are used that together divide the body; where there are
    none, or several choices, a warning names the groups. 0 is an element without group.

    Args:
        members: Elements of each group; the order decides between groups of the same elements.
        sizes: Number of elements that each stands for; 1 for single elements.
        names: Names of groups for messages.
        source: The file in messages.

    Returns:
        None where no element has a group.

    Raises:
        MeshError: There are too many groups.
    """
    if len(members) > _MOST:
        raise MeshError(f"it has {len(members)} groups or sets; write {_MOST} or fewer.")
    groups = {number: np.unique(rows) for number, rows in members.items() if len(rows)}
    if not groups:
        return None
    regions, overlapping = _smallest(groups, sizes)
    if overlapping:
        shown = ", ".join(_title(number, names) for number in list(groups)[:_SHOWN])
        choices = _divisions(groups, sizes)
        if choices:
            regions, _ = _smallest({number: groups[number] for number in choices[0]}, sizes)
        used = ", ".join(_title(number, names) for number in (choices[0] if choices else []))
        if len(choices) == 1:
            _log.warning(
                "'%s': of the overlapping groups %s, regions are %s, which divide the body.",
                source, shown, used,
            )  # fmt: skip
        else:
            _log.warning(
                "'%s': the groups %s overlap, and it is not clear which divide the body; regions "
                "are %s. Keep the groups of one division in the file.",
                source, shown, used or "the smallest group of each element",
            )  # fmt: skip
    present = np.unique(regions).tolist()
    _log.info("'%s': regions %s.", source, ", ".join(_title(n, names) for n in present))
    if 0 in present and len(present) > 1:
        without = int(sizes[regions == 0].sum())
        _log.warning("'%s': %d elements are in no group; their region is 0.", source, without)
    return regions


def _title(number: int, names: Mapping[int, str]) -> str:
    return f"{number} ({names[number]})" if number in names else str(number)


def _smallest(
    groups: Mapping[int, Int[np.ndarray, " k"]], sizes: Float[np.ndarray, " e"]
) -> tuple[Int[np.ndarray, " e"], bool]:
    """Return the smallest group of each element, and whether groups overlap."""
    regions, overlapping = np.zeros(len(sizes), dtype=np.int64), False
    totals = {number: sizes[rows].sum() for number, rows in groups.items()}
    for number in sorted(groups, key=lambda n: -totals[n]):
        outer = regions[groups[number]]
        if (outer != outer[0]).any():
            overlapping = True
        elif outer[0] and totals[int(outer[0])] == totals[number]:
            continue  # the same elements under another name
        regions[groups[number]] = number
    return regions, overlapping


def _divisions(
    groups: Mapping[int, Int[np.ndarray, " k"]], sizes: Float[np.ndarray, " e"]
) -> list[tuple[int, ...]]:
    """Return the choices of two groups or more that have each element of any group once."""
    if len(groups) > _MANY:
        return []
    covered = np.unique(np.concatenate(list(groups.values())))
    totals = {number: sizes[rows].sum() for number, rows in groups.items()}
    return [
        choice
        for count in range(2, len(groups) + 1)
        for choice in combinations(groups, count)
        if sum(totals[number] for number in choice) == sizes[covered].sum()
        and len(np.unique(np.concatenate([groups[n] for n in choice]))) == len(covered)
    ]

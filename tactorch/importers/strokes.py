"""Rows of a palpation: which are at one place, and in which of them the ball is pressed in."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

_GRID = 0.25  # to which places are rounded, over the distance at which they are apart
_ONE_PLACE = 0.6  # extent of rows that are near each other wherever they are rounded to, over it
_ASIDE = 0.2  # motion aside over motion along, up to which rows are of the approach
_JITTER, _MAX_STILL = 5.0, 20.0  # motion that is none, over the noise of positions, at most
_THIRD, _SCATTER, _MIN_SHARE = 3, 2.0, 0.08  # see `find_mixed`
# Rows that repeat the largest force, at least, and over those that repeat another one; rise of the
# force before over its noise and its steps, from which it would have risen further.
_REPEATED, _LONGER, _RISE = 3, 2.0, 4.0
_TURNS, _MIN_TURNS = 0.3, 4  # reversals of unordered rows, over their moves, and their number


class Stroke(NamedTuple):
    """Rows of a probe."""

    pressed: Int[np.ndarray, " p"]  # the approach, and the contact until the ball is deepest
    lifted: Int[np.ndarray, " l"]  # after the deepest, until the ball is highest
    moved: int  # number of rows before the approach
    ordered: bool  # whether rows are in an order of time


def find_places(
    xy_mm: Float[np.ndarray, "s 2"], apart_mm: float, min_rows: int
) -> Int[np.ndarray, " s"]:
    """Return the number of the place of each row; places have no rows that are near each other.

    Rows of places with few rows have -1, unless there are no others.
    """
    if np.linalg.norm(np.ptp(xy_mm, axis=0)) < _ONE_PLACE * apart_mm:
        return np.zeros(len(xy_mm), dtype=int)
    cells, cell = np.unique(np.round(xy_mm / (_GRID * apart_mm)), axis=0, return_inverse=True)
    pairs = cKDTree(cells).query_pairs(1.0 / _GRID, output_type="ndarray")
    ones = np.ones(len(pairs), dtype=bool)
    graph = coo_matrix((ones, (pairs[:, 0], pairs[:, 1])), shape=(len(cells), len(cells)))
    place = connected_components(graph, directed=False)[1][cell.ravel()]
    enough = np.bincount(place) >= min_rows
    if not enough.any():
        return np.zeros(len(xy_mm), dtype=int)
    _, first = np.unique(place, return_index=True)
    numbers = np.full(len(enough), -1)
    kept = np.flatnonzero(enough)
    numbers[kept[np.argsort(first[kept])]] = np.arange(len(kept))
    of_rows: np.ndarray = numbers[place]
    return of_rows


def find_stroke(
    centres: Float[np.ndarray, "n 3"], outward: Float[np.ndarray, "3"], still_mm: float, timed: bool
) -> Stroke:
    """Return which rows of a probe are those of its loading branch.

    These are the rows, on a straight line to the deepest, in which the ball is as deep as never
    before: neither lifted nor pressed in again.

    Args:
        centres: Places of the ball, in the order of the rows, mm.
        outward: Direction out of the object.
        still_mm: Motion that is none; more where positions have noise.
        timed: Whether the order is that of time. Otherwise rows that go to and fro, or begin with
            the deepest, are taken by their depth.
    """
    depth = -(centres @ outward)
    second = np.abs(np.diff(depth, n=2))
    noise = float(np.median(second)) / (0.6745 * np.sqrt(6.0)) if len(second) else 0.0
    top = int(np.argmax(depth >= depth.max() - max(still_mm, noise)))
    still_mm *= min(max(_JITTER * noise / still_mm, 1.0), _MAX_STILL)
    if not timed and (top == 0 or _to_and_fro(depth, still_mm)):
        return Stroke(np.argsort(depth, kind="stable"), np.arange(0), 0, ordered=False)
    begin = _begin(centres[: top + 1], depth[: top + 1], still_mm)
    down = depth[begin : top + 1]
    new = down >= np.maximum.accumulate(down) - still_mm
    bottom = top + int(np.argmax(depth[top:] <= depth[top:].min() + still_mm))
    lifted = np.arange(top + 1, bottom + 1)
    return Stroke(begin + np.flatnonzero(new), lifted, begin, ordered=True)


def _to_and_fro(depth: Float[np.ndarray, " n"], still_mm: float) -> bool:
    moves = np.diff(depth)
    moves = moves[np.abs(moves) > still_mm]
    turns = int((moves[1:] * moves[:-1] < 0.0).sum())
    return turns > max(_MIN_TURNS, _TURNS * len(moves))


def _begin(
    centres: Float[np.ndarray, "n 3"], depth: Float[np.ndarray, " n"], still_mm: float
) -> int:
    """Return the first row of the straight motion to the last row."""
    before = centres[-1] - centres
    above = np.flatnonzero(depth[-1] - depth >= 0.5 * np.ptp(depth))
    push = before[above[-1]]
    length = float(np.linalg.norm(push))
    if length <= still_mm:
        return 0
    along = before @ (push / length)
    aside = np.linalg.norm(before - along[:, None] * (push / length), axis=1)
    off = np.flatnonzero(aside > _ASIDE * np.abs(along) + still_mm)
    return int(off[-1]) + 1 if len(off) else 0


def is_limited(advance: Float[np.ndarray, " p"], force: Float[np.ndarray, " p"]) -> bool:
    """Return whether a loading branch ends at the largest force that the sensor measures.

    There the sensor repeats one force while the ball advances. Slow and coarse sensors repeat
    others, too, but in fewer rows, and hardly rise over as long a way before.
    """
    begins = np.flatnonzero(np.diff(force, prepend=np.nan, append=np.nan))
    values, counts, top = force[begins[:-1]], np.diff(begins), force.max()
    run = int(np.argmax(np.where(values == top, counts, 0)))
    upper = (values < top) & (values > 0.5 * (top + force.min()))
    if counts[run] < max(_REPEATED, _LONGER * counts[upper].max(initial=1)):
        return False
    first, last = begins[run], begins[run + 1] - 1
    before = 2.0 * advance[first] - advance[last]  # as far from the first as the last
    rise = top - force[np.argmin(np.abs(advance[: first + 1] - before))]
    steps = np.diff(np.unique(force)).min(initial=np.inf)
    noise = np.median(np.abs(np.diff(force, n=2))) / (0.6745 * np.sqrt(6.0))
    return bool(advance[last] > advance[first] and rise > _RISE * max(steps, noise))


def find_steps(
    advance: Float[np.ndarray, " p"], force: Float[np.ndarray, " p"], still_mm: float
) -> tuple[list[int], float, float]:
    """Return the rows of a loading branch that are deeper by `still_mm` than the one before.

    Also by how much the force falls from each of these to the last row before the next, and by how
    much it rises from there to the next, in total.
    """
    deepest, rows = np.maximum.accumulate(advance), [0]
    while (row := int(np.searchsorted(deepest, deepest[rows[-1]] + still_mm))) < len(advance):
        rows.append(row)
    last = np.array([*rows[1:], len(advance)]) - 1
    fall = float((force[rows] - force[last]).sum())
    return rows, fall, float(force[last[-1]] - force[0]) + fall


def find_mixed(probes: Sequence[tuple[np.ndarray, np.ndarray]]) -> float:
    """Return the scatter of large forces at equal depth, over them; 0 where it is that of small.

    Forces of two branches scatter in proportion to themselves, those of one by the noise. Each
    probe has the advances (mm) and forces (N) of its rows.
    """
    scatter, level = [np.zeros(0)], [np.zeros(0)]
    for advance, force in probes:
        order = np.argsort(advance, kind="stable")
        d, f = advance[order], force[order]
        share = (d[1:-1] - d[:-2]) / np.maximum(d[2:] - d[:-2], 1e-300)
        # A row between two others, from the line through them.
        scatter.append(
            (f[1:-1] - (1.0 - share) * f[:-2] - share * f[2:])
            / np.sqrt(1.0 + share**2 + (1.0 - share) ** 2)
        )
        level.append(f[1:-1])
    order = np.argsort(np.concatenate(level))
    forces, squares = np.concatenate(level)[order], np.concatenate(scatter)[order] ** 2
    if (count := len(order) // _THIRD) < _THIRD:
        return 0.0
    small, large = (float(np.sqrt(np.mean(part))) for part in (squares[:count], squares[-count:]))
    over = large / max(float(np.median(forces[-count:])), 1e-300)
    return over if large > _SCATTER * small and over > _MIN_SHARE else 0.0


def lost_work(
    pressed: tuple[Float[np.ndarray, " p"], Float[np.ndarray, " p"]],
    lifted: tuple[Float[np.ndarray, " l"], Float[np.ndarray, " l"]],
    min_mm: float,
) -> tuple[float, float, float]:
    """Return the work that the object does not give back (N mm), and between which advances (mm).

    Each branch has advances (mm) and forces (N). The values are NaN where the branches have less
    than `min_mm` in common.
    """
    low = max(part[0].min(initial=np.inf) for part in (pressed, lifted))
    high = min(part[0].max(initial=-np.inf) for part in (pressed, lifted))
    if not high - low > min_mm:
        return np.nan, np.nan, np.nan
    grid = np.linspace(low, high, 100)
    first, second = (
        np.interp(grid, advance[order], force[order])
        for advance, force in (pressed, lifted)
        for order in [np.argsort(advance, kind="stable")]
    )
    return float(np.trapezoid(first - second, grid)), float(low), float(high)

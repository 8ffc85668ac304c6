"""Assignment of spots to the markers of a reference, without knowledge of earlier frames.

Markers on a gel look alike, and a grid that is off by a pitch fits almost as well as the right one.
Several assignments are therefore grown from small patches over the grid, each marker where the
motion of its neighbors puts it, and compared as wholes: by how smoothly the markers move, how many
have no spot, and how many spots have no marker. Markers to which assignments of similar quality
give different spots are ambiguous.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from tactorch.mesh.geometry import farthest_point_order

_SEEDS = 8  # markers over the grid from which assignments are grown
_SEED_REACH = 1.8  # largest displacement of a seed, in spacings
_SEED_SPOTS = 10
_PATCH_GATE, _MIN_PATCH = 0.25, 0.7  # distance in spacings, and fraction of neighbors found
_GROWTH_GATE = 0.45  # distance of a spot from where the neighbors put a marker, in spacings
_STRAIN = 0.1  # typical deviation from the neighbors' affine motion, in spacings
LOST_COST = 6.0  # cost of a marker without spot, and of a spot without marker
_MOTION = 0.02  # cost of a displacement by a spacing: of equal assignments, the least motion
_BORDER = 0.4  # of a spacing, from the image's edge, where markers come and go
_POOR = 0.4  # of the cost without any spot, above which no assignment is accepted
SIMILAR_COST = 12.0  # difference of costs below which assignments are of similar quality

Points = Float[np.ndarray, "_ 2"]


@dataclass(frozen=True, eq=False)
class Grid:
    """Markers of a reference image.

    Attributes:
        points: Positions (column, row), px.
        neighbors: Indices of each marker's neighbors.
        spacing_px: Typical distance of neighbors.
        size_px: Width and height of the image.
        gate: Largest distance of a spot from a predicted marker, in spacings.
    """

    points: Points
    neighbors: Int[np.ndarray, "n k"]
    spacing_px: float
    size_px: tuple[int, int]
    gate: float

    def predict(self, positions: Points) -> tuple[Points, Int[np.ndarray, " n"]]:
        """Return where the motion of its neighbors puts each marker, and their number."""
        motion = positions - self.points
        smooth = smooth_motion(self.points, motion, self.neighbors)
        return self.points + smooth, np.isfinite(motion[self.neighbors, 0]).sum(axis=1)

    def inside(self, positions: Points) -> Bool[np.ndarray, " _"]:
        """Return which positions are in the image, away from its edge."""
        margin = _BORDER * self.spacing_px
        size = np.array(self.size_px)
        return np.asarray(((positions >= margin) & (positions <= size - 1 - margin)).all(axis=1))

    def cost(self, positions: Points, spots: Points) -> float:
        """Return the cost of an assignment: roughness, markers and spots left over, and motion."""
        known = np.isfinite(positions[:, 0])
        if known.sum() < 4:
            return np.inf
        predicted, _ = self.predict(positions)
        deviation = np.linalg.norm(positions - predicted, axis=1) / (_STRAIN * self.spacing_px)
        rough = np.minimum(deviation[known] ** 2, LOST_COST).sum()
        lost = (~known & self.inside(predicted)).sum()
        # A spot left over is one too many if a marker was at its place in the reference.
        tree = cKDTree(positions[known])
        distance, nearest = tree.query(spots)
        left = distance > 0.05 * self.spacing_px
        motion = (positions - self.points)[known]
        origin = spots[left] - motion[nearest[left]]
        spare = int(self.inside(origin).sum())
        length = np.linalg.norm(motion, axis=1).sum() / self.spacing_px
        return float(rough + LOST_COST * (lost + spare) + _MOTION * length)


@dataclass(frozen=True, eq=False)
class Match:
    """Best assignment of spots to markers.

    Attributes:
        positions: Position of each marker, (n, 2), px; NaN for markers without spot.
        ambiguous: Markers to which an assignment of similar quality gives another spot.
        cost: Cost of the assignment, see `Grid.cost`.
    """

    positions: Points
    ambiguous: Bool[np.ndarray, " n"]
    cost: float


def match_markers(grid: Grid, spots: Points, guesses: Iterable[Points] = ()) -> Match:
    """Return the assignment of least cost of the spots in a frame.

    `guesses` are further assignments to compare, such as that of a tracker.
    """
    candidates = [guess for guess in guesses if np.isfinite(guess[:, 0]).any()]
    for seed in _seeds(grid, spots):
        if not any(_contains(candidate, seed) for candidate in candidates):
            candidates.append(_grow(grid, spots, seed))
    if not candidates:
        nothing = np.full(grid.points.shape, np.nan)
        return Match(nothing, np.full(len(nothing), len(spots) > 0), np.inf)
    costs = np.array([grid.cost(candidate, spots) for candidate in candidates])
    best = candidates[int(np.argmin(costs))]
    # Where most markers have no place that fits, those that do fit by chance.
    is_poor = costs.min() > _POOR * LOST_COST * len(best)
    ambiguous = np.full(len(best), bool(is_poor))
    for candidate, cost in zip(candidates, costs, strict=True):
        if cost < costs.min() + SIMILAR_COST:
            apart = np.linalg.norm(candidate - best, axis=1)
            ambiguous |= np.nan_to_num(apart) > 0.3 * grid.spacing_px
    return Match(best, ambiguous, float(costs.min()))


def _contains(candidate: Points, seed: Points) -> bool:
    """Whether an assignment has nearly all of a patch."""
    patch = np.isfinite(seed[:, 0])
    same = np.linalg.norm(candidate[patch] - seed[patch], axis=1) < 1e-6
    return bool(same.mean() > 0.8)


def _seeds(grid: Grid, spots: Points) -> list[Points]:
    """Assignments of small patches that keep their shape."""
    if len(spots) < 4:
        return []
    tree, seeds = cKDTree(spots), []
    center = int(np.argmin(np.linalg.norm(grid.points - grid.points.mean(axis=0), axis=1)))
    for marker in farthest_point_order(grid.points, _SEEDS, center):
        patch = np.append(grid.neighbors[marker], marker)
        near = min(_SEED_SPOTS, len(spots))
        distance, index = tree.query(grid.points[marker], k=near)
        for spot in np.atleast_1d(index)[np.atleast_1d(distance) < _SEED_REACH * grid.spacing_px]:
            shift = spots[spot] - grid.points[marker]
            apart, found = tree.query(grid.points[patch] + shift)
            close = apart < _PATCH_GATE * grid.spacing_px
            if close.mean() < _MIN_PATCH or len(set(found[close])) < close.sum():
                continue
            positions = np.full(grid.points.shape, np.nan)
            positions[patch[close]] = spots[found[close]]
            seeds.append(positions)
    return seeds


def _grow(grid: Grid, spots: Points, seed: Points) -> Points:
    """Extend an assignment over the grid, each marker by the motion of its neighbors."""
    positions, gate = seed.copy(), _GROWTH_GATE * grid.spacing_px
    for _ in range(len(positions)):
        predicted, count = grid.predict(positions)
        known = np.isfinite(positions[:, 0])
        frontier = ~known & (count >= 3)
        taken = cKDTree(positions[known]).query(spots)[0] < 1e-6
        found = assign_spots(predicted[frontier], spots[~taken], gate)
        if not np.isfinite(found).any():
            break
        positions[frontier] = found
    predicted, _ = grid.predict(positions)
    return assign_spots(predicted, spots, grid.gate * grid.spacing_px)


def assign_spots(predicted: Points, spots: Points, gate: float) -> Points:
    """Assign each marker at most one spot within the gate, minimizing squared distances."""
    positions = np.full(predicted.shape, np.nan)
    distance = np.linalg.norm(predicted[:, None] - spots[None], axis=2)
    # A constant cost beyond the gate: a marker without a spot does not displace another's match.
    rows, columns = linear_sum_assignment(np.minimum(distance, gate) ** 2)
    accepted = distance[rows, columns] < gate
    positions[rows[accepted]] = spots[columns[accepted]]
    return positions


def smooth_motion(positions: Points, motion: Points, neighbors: np.ndarray) -> Points:
    """Motion of each marker predicted by a robust affine fit to its neighbors' motion."""
    known = ~np.isnan(motion[:, 0])
    if not known.any():
        return np.zeros_like(motion)
    smooth = np.tile(np.median(motion[known], axis=0), (len(motion), 1))
    count = known[neighbors].sum(axis=1)
    few, many = (count > 0) & (count < 4), count >= 4
    smooth[few] = np.nanmedian(motion[neighbors[few]], axis=1)
    offsets = positions[neighbors[many]] - positions[many][:, None]
    smooth[many] = _affine_fits(offsets, motion[neighbors[many]])
    return smooth


def _affine_fits(
    offsets: Float[np.ndarray, "n k 2"], motion: Float[np.ndarray, "n k 2"]
) -> Float[np.ndarray, "n 2"]:
    """Values at offset 0 of affine displacements, fitted by reweighted least squares."""
    known = ~np.isnan(motion[..., :1])
    offsets, motion = np.where(known, offsets, 0.0), np.where(known, motion, 0.0)
    scale = np.abs(offsets).max(axis=(1, 2), keepdims=True)
    design = np.concatenate([known, offsets / scale], axis=2)
    ridge = np.diag([0.0, 0.05, 0.05])  # neighbors on a line determine one slope only
    weight = np.ones(known.shape)
    for _ in range(4):
        transposed = (weight * design).swapaxes(1, 2)
        fit = np.linalg.solve(transposed @ design + ridge, transposed @ motion)
        residual = np.linalg.norm(motion - design @ fit, axis=2, keepdims=True)
        spread = np.nanmedian(np.where(known, residual, np.nan), axis=1, keepdims=True)
        weight = 1.0 / (1.0 + (residual / (2.0 * np.maximum(spread, 0.1))) ** 2)
    return fit[:, 0]

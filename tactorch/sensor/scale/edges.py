"""Edges of a pressed flat face as straight lines, and the corners at which they meet.

Next to a flat punch the slope of the gel jumps, or grows without bound and decreases with the
square root of the distance (Boussinesq, 1885), as for soft and thick layers. Camera and smoothing
blur both, so that the steepest point of a blurred profile is up to a pixel inside the edge. The
edge is therefore located by a fit of both blurred profiles.
"""

from functools import cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import gaussian_filter1d, map_coordinates
from scipy.optimize import nnls

from tactorch.errors import ConfigError
from tactorch.sensor.scale.shape import KnownShape, Outline, sides, square_side

_SEARCH_FRACTIONS = (0.07, 0.04, 0.025)  # half width of each search, over the face's size
_END_FRACTION = 0.1  # of an edge ignored at both ends, where corners are rounded
_BLOCK_PX = 5.0  # length over which profiles are averaged
_STEP_PX = 0.25
_MIN_KNOWN = 0.5  # fraction of a block's pixels not covered by markers
_MIN_BLOCKS = 5
_BIAS_PX = 0.15  # of the position of edges, measured on rendered punches
_MAX_DEVIATION = 0.012  # of points of an edge from a line, over the face's size
_BLURS_PX = (0.6, 0.9, 1.2, 1.6, 2.2)
_MAX_SHIFT_PX = 2.0
_SHIFT_STEP_PX = 0.05
_FINE_PX, _REACH_PX = 0.05, 30.0
_OFFSETS_PX = np.arange(-8.0, 8.01, 0.25)  # of the final profiles, outward


class _Line(NamedTuple):
    """Offsets of a line at both ends of an approximate edge, px, and scatter of its points."""

    offsets: Float[np.ndarray, "2"]
    covariance: Float[np.ndarray, "2 2"]
    scatter_px: float


def refine_outline(
    change: Float[np.ndarray, "h w 3"],
    known: Bool[np.ndarray, "h w"],
    rough: Float[np.ndarray, "n 2"],
    shape: KnownShape,
    name: str,
) -> Outline:
    """Fit the edges of a rough outline to where the change of color starts outward.

    Raises:
        ConfigError: An edge is not visible, or not straight; the message names the image.
    """
    missing = f"{name}: no {shape.name} found;"
    remedy = "Give its corners by hand, or leave it out."
    corners, size = rough, square_side(rough)
    for fraction in _SEARCH_FRACTIONS:
        lines = []
        for start, end in sides(corners):
            line = _find_line(change, known, start, end, max(3.0, fraction * size))
            if line is None:
                raise ConfigError(
                    f"{missing} the edge from ({start[0]:.0f}, {start[1]:.0f}) to"
                    f" ({end[0]:.0f}, {end[1]:.0f}) px is not visible. {remedy}"
                )
            lines.append(line)
        corners, deviation = _intersect(corners, lines)
    scatter = max(line.scatter_px for line in lines)
    if scatter > max(_MAX_DEVIATION * size, 1.0):
        raise ConfigError(
            f"{missing} the edges of what changed deviate by {scatter:.1f} px from straight lines."
            f" {remedy}"
        )
    profiles = [_profiles(change, known, *side, _OFFSETS_PX) for side in sides(corners)]
    shifts = [_edge_shift(_mean_profile(values, valid)) for values, valid, _ in profiles]
    shift = float(np.median(shifts))  # common to all edges
    offset = _Line(np.array([shift, shift]), np.zeros((2, 2)), 0.0)
    shifted, _ = _intersect(corners, [offset] * len(corners))
    return Outline(name, shifted, deviation, float(np.hypot(np.std(shifts), _BIAS_PX)))


def _find_line(
    change: np.ndarray, known: np.ndarray, start: np.ndarray, end: np.ndarray, reach: float
) -> _Line | None:
    """Fit a line to the steepest points near an approximate edge; None if there are too few."""
    offsets = np.arange(-reach - 3.0, reach + 3.0 + _STEP_PX, _STEP_PX)
    values, valid, positions = _profiles(change, known, start, end, offsets)
    blocks = max(_MIN_BLOCKS, round(len(positions) / _BLOCK_PX))
    block_positions, edge_offsets, weights = [], [], []
    for block in np.array_split(np.arange(len(positions)), blocks):
        if len(block) == 0 or valid[block].mean() < _MIN_KNOWN:
            continue
        peak = _steepest(_mean_profile(values[block], valid[block]), offsets, reach)
        if peak is not None:
            block_positions.append(float(positions[block].mean()))
            edge_offsets.append(peak[0])
            weights.append(peak[1])
    if len(weights) < _MIN_BLOCKS:
        return None
    return _fit_line(np.array(block_positions), np.array(edge_offsets), np.array(weights))


def _profiles(
    change: np.ndarray, known: np.ndarray, start: np.ndarray, end: np.ndarray, offsets: np.ndarray
) -> tuple[Float[np.ndarray, "s o"], Bool[np.ndarray, "s o"], Float[np.ndarray, " s"]]:
    """Profiles of the change across an edge for each pixel along it, and where they are valid.

    An edge has one orientation and hence one color of change, the mean color outside it.
    """
    length = float(np.linalg.norm(end - start))
    along = (end - start) / length
    outward = np.array([along[1], -along[0]])
    steps = np.arange(_END_FRACTION * length, (1 - _END_FRACTION) * length, 1.0)
    points = start + steps[:, None, None] * along + offsets[:, None] * outward
    indices = [points[..., 1], points[..., 0]]
    # Pixels outside the image are not valid.
    valid = map_coordinates(known.astype(float), indices, order=1, cval=0.0) > 0.99
    values = np.stack(
        [map_coordinates(change[..., k], indices, order=1, mode="nearest") for k in range(3)],
        axis=-1,
    )
    outside = valid & (offsets > 0)
    color = values[outside].mean(axis=0) if outside.any() else np.ones(3)
    return values @ (color / max(float(np.linalg.norm(color)), 1e-12)), valid, steps / length


def _mean_profile(values: Float[np.ndarray, "s o"], valid: Bool[np.ndarray, "s o"]) -> np.ndarray:
    """Mean profile over valid pixels; over all pixels where none is valid."""
    count = valid.sum(axis=0)
    mean = np.where(valid, values, 0.0).sum(axis=0) / np.maximum(count, 1)
    return np.where(count > 0, mean, values.mean(axis=0))


def _steepest(
    profile: Float[np.ndarray, " o"], offsets: Float[np.ndarray, " o"], reach: float
) -> tuple[float, float] | None:
    """Offset of the largest slope of a profile within reach, and the slope."""
    slope = gaussian_filter1d(profile, 1.0 / _STEP_PX, order=1) / _STEP_PX
    candidates = np.where(np.abs(offsets) <= reach, slope, -np.inf)
    i = int(candidates.argmax())
    if not np.isfinite(candidates[i]) or candidates[i] <= 0 or not 0 < i < len(slope) - 1:
        return None
    before, peak, after = slope[i - 1 : i + 2]
    curvature = before - 2 * peak + after
    shift = 0.5 * (before - after) / curvature if curvature < 0 else 0.0
    return float(offsets[i] + np.clip(shift, -1, 1) * _STEP_PX), float(peak)


def _fit_line(
    positions: Float[np.ndarray, " b"],
    offsets: Float[np.ndarray, " b"],
    weights: Float[np.ndarray, " b"],
) -> _Line:
    """Fit a line with Tukey's biweight."""
    design = np.column_stack([1 - positions, positions])
    prior = np.minimum(weights / np.median(weights), 1.0)
    fit = np.full(2, float(np.median(offsets)))
    for _ in range(10):
        residual = offsets - design @ fit
        spread = max(1.4826 * float(np.median(np.abs(residual))), 0.05)
        robust = np.clip(1 - (residual / (4.7 * spread)) ** 2, 0.0, None) ** 2
        total = prior * robust
        normal = design.T @ (total[:, None] * design) + 1e-9 * np.eye(2)
        fit = np.linalg.solve(normal, design.T @ (total * offsets))
    residual = offsets - design @ fit
    freedom = max(float(total.sum()) - 2.0, 1.0)
    variance = float(total @ residual**2) / freedom
    scatter = float(np.sqrt(np.median(residual**2)) * 1.4826)
    return _Line(fit, variance * np.linalg.inv(normal), scatter)


def _intersect(
    corners: Float[np.ndarray, "n 2"], lines: list[_Line]
) -> tuple[Float[np.ndarray, "n 2"], float]:
    """Intersections of adjacent lines, and their standard deviation, px."""
    following = np.roll(corners, -1, axis=0)
    outward = (following - corners) @ np.array([(0.0, -1.0), (1.0, 0.0)])
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    starts = corners + np.array([line.offsets[:1] for line in lines]) * outward
    ends = following + np.array([line.offsets[1:] for line in lines]) * outward
    normals = (ends - starts) @ np.array([(0.0, -1.0), (1.0, 0.0)])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    distances = (normals * starts).sum(axis=1)
    pairs = np.stack([np.roll(normals, 1, axis=0), normals], axis=1)
    right = np.column_stack([np.roll(distances, 1), distances])
    inverse = np.linalg.inv(pairs)
    # Variances of both offsets, propagated through the same equations.
    variances = np.column_stack(
        [np.roll([line.covariance[1, 1] for line in lines], 1),
         [line.covariance[0, 0] for line in lines]]
    )  # fmt: skip
    variance = (inverse**2 * variances[:, None]).sum() / 2 / len(corners)
    return (inverse @ right[..., None])[..., 0], float(np.sqrt(variance))


def _edge_shift(profile: Float[np.ndarray, " o"]) -> float:
    """Outward distance of the face's edge from a line, px, by the profile at `_OFFSETS_PX`."""
    best, edge = np.inf, 0.0
    for shift in np.arange(-_MAX_SHIFT_PX, _MAX_SHIFT_PX + _SHIFT_STEP_PX / 2, _SHIFT_STEP_PX):
        distance = _OFFSETS_PX - shift
        outside = np.maximum(distance, 0.0)
        free = [np.ones_like(distance), np.sqrt(outside), outside]
        for blur in _BLURS_PX:
            rises = [np.interp(distance, *pair) for pair in _blurred_steps(blur)]
            # The amplitudes of the steps are nonnegative, those of the other terms free.
            terms = np.column_stack([*rises, *free, *(-term for term in free)])
            misfit = nnls(terms, profile)[1]
            if misfit < best:
                best, edge = misfit, float(shift)
    return edge


@cache
def _blurred_steps(blur_px: float) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """Blurred step, and blurred inverse square root: positions and values."""
    positions = np.arange(-_REACH_PX, _REACH_PX, _FINE_PX) + _FINE_PX / 2
    outside = positions > 0
    root = np.where(outside, 1.0 / np.sqrt(np.where(outside, positions, 1.0)), 0.0)
    return tuple(
        (positions, gaussian_filter1d(values, blur_px / _FINE_PX))
        for values in (outside.astype(float), root)
    )

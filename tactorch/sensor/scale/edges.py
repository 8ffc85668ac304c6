"""Edges of a pressed flat face as straight lines, and the corners at which they meet.

Next to a flat punch the slope of the gel jumps, or grows without bound and decreases with the
square root of the distance (Boussinesq, 1885), as for soft and thick layers. Camera and smoothing
blur both, so that the steepest point of a blurred profile is up to a pixel inside the edge. The
edge is therefore located by a fit of both blurred profiles.
"""

from functools import cache

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import gaussian_filter1d, map_coordinates
from scipy.optimize import nnls

from tactorch.errors import ConfigError
from tactorch.sensor.scale.shape import Corners, KnownShape, Outline, sides, square_side

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

# Outward offsets at both ends of an edge, px, their variances, and the scatter of the points.
_Line = tuple[np.ndarray, np.ndarray, float]


def refine_outline(
    change: np.ndarray, known: np.ndarray, rough: Corners, shape: KnownShape, name: str
) -> Outline:
    """Fit the edges of a rough outline to where the change of color starts outward."""
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
        offsets, variances, scatters = (np.array(column) for column in zip(*lines, strict=True))
        corners, deviation = _intersect(corners, offsets, variances)
    scatter = float(scatters.max())
    if scatter > max(_MAX_DEVIATION * size, 1.0):
        raise ConfigError(
            f"{missing} the edges of what changed deviate by {scatter:.1f} px from straight lines."
            f" {remedy}"
        )
    profiles = [_profiles(change, known, *side, _OFFSETS_PX) for side in sides(corners)]
    shifts = [_edge_shift(_mean_profile(values, valid)) for values, valid, _ in profiles]
    common_shift = np.full(corners.shape, np.median(shifts))
    shifted, _ = _intersect(corners, common_shift, np.zeros(corners.shape))
    return Outline(name, shifted, deviation, float(np.hypot(np.std(shifts), _BIAS_PX)))


def _find_line(
    change: np.ndarray, known: np.ndarray, start: np.ndarray, end: np.ndarray, reach: float
) -> _Line | None:
    """Fit a line to the steepest points near an approximate edge; None if there are too few."""
    offsets = np.arange(-reach - 3.0, reach + 3.0 + _STEP_PX, _STEP_PX)
    values, valid, positions = _profiles(change, known, start, end, offsets)
    blocks = max(_MIN_BLOCKS, round(len(positions) / _BLOCK_PX))
    points = []
    for block in np.array_split(np.arange(len(positions)), blocks):
        if len(block) == 0 or valid[block].mean() < _MIN_KNOWN:
            continue
        peak = _steepest(_mean_profile(values[block], valid[block]), offsets, reach)
        if peak is not None:
            points.append((float(positions[block].mean()), *peak))
    return _fit_line(*np.array(points).T) if len(points) >= _MIN_BLOCKS else None


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
    channels = np.moveaxis(change, -1, 0)
    values = np.stack([map_coordinates(c, indices, order=1, mode="nearest") for c in channels], -1)
    outside = valid & (offsets > 0)
    color = values[outside].mean(axis=0) if outside.any() else np.ones(3)
    return values @ (color / max(float(np.linalg.norm(color)), 1e-12)), valid, steps / length


def _mean_profile(values: Float[np.ndarray, "s o"], valid: Bool[np.ndarray, "s o"]) -> np.ndarray:
    """Mean profile over valid pixels; over all pixels where none is valid."""
    count = valid.sum(axis=0)
    mean = np.where(valid, values, 0.0).sum(axis=0) / np.maximum(count, 1)
    return np.where(count > 0, mean, values.mean(axis=0))


def _steepest(profile: np.ndarray, offsets: np.ndarray, reach: float) -> tuple[float, float] | None:
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


def _fit_line(positions: np.ndarray, offsets: np.ndarray, weights: np.ndarray) -> _Line:
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
    return fit, variance * np.diag(np.linalg.inv(normal)), scatter


def _intersect(corners: Corners, offsets: Corners, variances: Corners) -> tuple[Corners, float]:
    """Intersections of adjacent lines with offsets from the sides, and their deviation, px."""
    following = np.roll(corners, -1, axis=0)
    normals = _normals(corners, following)
    starts, ends = corners + offsets[:, :1] * normals, following + offsets[:, 1:] * normals
    normals = _normals(starts, ends)
    distances = (normals * starts).sum(axis=1)
    inverse = np.linalg.inv(np.stack([np.roll(normals, 1, axis=0), normals], axis=1))
    right = np.stack([np.roll(distances, 1), distances], axis=1)
    # Variances of both offsets, propagated through the same equations.
    adjacent = np.stack([np.roll(variances[:, 1], 1), variances[:, 0]], axis=1)
    variance = (inverse**2 * adjacent[:, None]).sum() / 2 / len(corners)
    return (inverse @ right[..., None])[..., 0], float(np.sqrt(variance))


def _normals(starts: np.ndarray, ends: np.ndarray) -> Corners:
    x, y = (ends - starts).T
    return np.column_stack([y, -x]) / np.hypot(x, y)[:, None]


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

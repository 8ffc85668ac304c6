"""Edges of a pressed face, each found as a straight line, and the corners where they meet."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import gaussian_filter1d, map_coordinates

from tactorch.errors import ConfigError
from tactorch.sensor.scale.profile import OFFSETS_PX, edge_of
from tactorch.sensor.scale.shape import KnownShape, Outline

_REACHES = (0.07, 0.04, 0.025)  # to both sides of an edge, as shares of the face's size, in turn
_ENDS = 0.1  # share of an edge that is left out at both ends, where corners are round
_BLOCK_PX = 5.0  # of an edge that are averaged
_STEP_PX = 0.25
_LEAST_KNOWN = 0.5  # share of a block's pixels that no marker covers
_LEAST_BLOCKS = 5
_MODEL_PX = 0.15  # by which edges are seen too far out or in, measured on rendered punches
_BENT = 0.012  # share of the face's size by which points of an edge stray from a line


@dataclass(frozen=True, eq=False)
class _Line:
    """A line, as offsets along the normal of a rough edge, at its two ends.

    Attributes:
        offsets: At the rough edge's begin and end, px.
        covariance: Of the two.
        stray_px: Of its points, root mean square.
    """

    offsets: Float[np.ndarray, "2"]
    covariance: Float[np.ndarray, "2 2"]
    stray_px: float


def refined(
    changed: Float[np.ndarray, "h w 3"],
    known: Bool[np.ndarray, "h w"],
    rough: Float[np.ndarray, "n 2"],
    shape: KnownShape,
    name: str,
) -> Outline:
    """Return an outline whose edges are where the change begins, going out.

    Args:
        changed: Change of the colours.
        known: Pixels that no marker covers.
        rough: Corners (column, row), to some pixels.
        shape: What was pressed.
        name: Of the image, for messages.

    Raises:
        ConfigError: An edge is not seen, or not straight; the message names the image.
    """
    corners, size = rough, float(np.sqrt(_area(rough)))
    for share in _REACHES:
        reach = max(3.0, share * size)
        lines = [
            _required(_line(changed, known, begin, end, reach), begin, end, shape, name)
            for begin, end in _sides(corners)
        ]
        corners, deviation = _met(corners, lines)
    stray = max(line.stray_px for line in lines)
    if stray > max(_BENT * size, 1.0):
        raise ConfigError(
            f"{name}: no {shape.name} found; the edges of what changed stray by {stray:.1f} px from"
            " straight lines. Give its corners by hand, or leave it out."
        )
    shifts = [_shift(changed, known, begin, end) for begin, end in _sides(corners)]
    shift = float(np.median(shifts))  # of one kind, all around
    out = _Line(np.array([shift, shift]), np.zeros((2, 2)), 0.0)
    moved, _ = _met(corners, [out] * len(corners))
    return Outline(name, moved, deviation, float(np.hypot(np.std(shifts), _MODEL_PX)))


def _sides(corners: Float[np.ndarray, "n 2"]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    return zip(corners, np.roll(corners, -1, axis=0), strict=True)


def _required(
    line: _Line | None, begin: np.ndarray, end: np.ndarray, shape: KnownShape, name: str
) -> _Line:
    if line is None:
        raise ConfigError(
            f"{name}: no {shape.name} found; the edge from ({begin[0]:.0f}, {begin[1]:.0f}) to"
            f" ({end[0]:.0f}, {end[1]:.0f}) px is not seen. Give its corners by hand, or leave it"
            " out."
        )
    return line


def _area(corners: Float[np.ndarray, "n 2"]) -> float:
    x, y = corners.T
    return 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))


def _line(
    changed: np.ndarray, known: np.ndarray, begin: np.ndarray, end: np.ndarray, reach: float
) -> _Line | None:
    """Fit a line to where the change rises most beside a rough edge; None where it does not."""
    offsets = np.arange(-reach - 3.0, reach + 3.0 + _STEP_PX, _STEP_PX)
    values, there, steps = _across(changed, known, begin, end, offsets)
    blocks = max(_LEAST_BLOCKS, round(len(steps) / _BLOCK_PX))
    at, found, weight = [], [], []
    for block in np.array_split(np.arange(len(steps)), blocks):
        if len(block) == 0 or there[block].mean() < _LEAST_KNOWN:
            continue
        peak = _steepest(_mean(values[block], there[block]), offsets, reach)
        if peak is not None:
            at.append(float(steps[block].mean()))
            found.append(peak[0])
            weight.append(peak[1])
    if len(at) < _LEAST_BLOCKS:
        return None
    return _fitted(np.array(at), np.array(found), np.array(weight))


def _shift(changed: np.ndarray, known: np.ndarray, begin: np.ndarray, end: np.ndarray) -> float:
    """By how much an edge lies farther out than where the change rises most, px."""
    values, there, _ = _across(changed, known, begin, end, OFFSETS_PX)
    return edge_of(_mean(values, there))


def _across(
    changed: np.ndarray, known: np.ndarray, begin: np.ndarray, end: np.ndarray, offsets: np.ndarray
) -> tuple[Float[np.ndarray, "s o"], Bool[np.ndarray, "s o"], Float[np.ndarray, " s"]]:
    """Profiles of the change across an edge, pixel by pixel along it, and where they are known.

    An edge faces one way all along, so its change has one colour: that beside it, on average.
    """
    length = float(np.linalg.norm(end - begin))
    along = (end - begin) / length
    outward = np.array([along[1], -along[0]])
    steps = np.arange(_ENDS * length, (1 - _ENDS) * length, 1.0)
    places = begin + steps[:, None, None] * along + offsets[:, None] * outward
    at = [places[..., 1], places[..., 0]]
    there = (
        map_coordinates(known.astype(float), at, order=1, cval=0.0) > 0.99
    )  # nor beside the image
    values = np.stack(
        [map_coordinates(changed[..., k], at, order=1, mode="nearest") for k in range(3)], axis=-1
    )
    beside = there & (offsets > 0)
    colour = values[beside].mean(axis=0) if beside.any() else np.ones(3)
    return values @ (colour / max(float(np.linalg.norm(colour)), 1e-12)), there, steps / length


def _mean(values: Float[np.ndarray, "s o"], there: Bool[np.ndarray, "s o"]) -> np.ndarray:
    """Mean profile over part of an edge, pixels without markers only where there are any."""
    count = there.sum(axis=0)
    some = np.where(there, values, 0.0).sum(axis=0) / np.maximum(count, 1)
    return np.where(count > 0, some, values.mean(axis=0))


def _steepest(
    profile: Float[np.ndarray, " o"], offsets: Float[np.ndarray, " o"], reach: float
) -> tuple[float, float] | None:
    """Where a profile rises most within reach, and how steeply."""
    slope = gaussian_filter1d(profile, 1.0 / _STEP_PX, order=1) / _STEP_PX
    likely = np.where(np.abs(offsets) <= reach, slope, -np.inf)
    i = int(likely.argmax())
    if not np.isfinite(likely[i]) or likely[i] <= 0 or not 0 < i < len(slope) - 1:
        return None
    before, top, after = slope[i - 1 : i + 2]
    bend = before - 2 * top + after
    shift = 0.5 * (before - after) / bend if bend < 0 else 0.0
    return float(offsets[i] + np.clip(shift, -1, 1) * _STEP_PX), float(top)


def _fitted(
    at: Float[np.ndarray, " b"], found: Float[np.ndarray, " b"], weight: Float[np.ndarray, " b"]
) -> _Line:
    """Fit a line robustly (Tukey's weights); its offsets at the edge's ends, with covariance."""
    design = np.column_stack([1 - at, at])
    own = np.minimum(weight / np.median(weight), 1.0)
    robust = np.ones(len(at))
    fit = np.full(2, float(np.median(found)))
    for _ in range(10):
        off = found - design @ fit
        spread = max(1.4826 * float(np.median(np.abs(off))), 0.05)
        robust = np.clip(1 - (off / (4.7 * spread)) ** 2, 0.0, None) ** 2
        total = own * robust
        normal = design.T @ (total[:, None] * design) + 1e-9 * np.eye(2)
        fit = np.linalg.solve(normal, design.T @ (total * found))
    off = found - design @ fit
    total = own * robust
    left = max(float(total.sum()) - 2.0, 1.0)
    variance = float(total @ off**2) / left
    return _Line(fit, variance * np.linalg.inv(normal), float(np.sqrt(np.median(off**2)) * 1.4826))


def _met(
    corners: Float[np.ndarray, "n 2"], lines: list[_Line]
) -> tuple[Float[np.ndarray, "n 2"], float]:
    """Where neighbouring lines meet, and the standard deviation of such a place, px."""
    count = len(corners)
    sides = np.roll(corners, -1, axis=0) - corners
    outward = np.column_stack([sides[:, 1], -sides[:, 0]])
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    met, variance = np.zeros_like(corners), 0.0
    for i in range(count):
        ends = []
        for k in (i - 1, i):
            begin = corners[k] + lines[k].offsets[0] * outward[k]
            end = corners[(k + 1) % count] + lines[k].offsets[1] * outward[k]
            ends.append((begin, end))
        normals = np.array([(b[1] - a[1], a[0] - b[0]) for a, b in ends])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        met[i] = np.linalg.solve(normals, [n @ a for n, (a, _) in zip(normals, ends, strict=True)])
        # Of both lines' offsets there, through the same equations.
        spread = np.linalg.inv(normals)
        offsets = np.diag([lines[i - 1].covariance[1, 1], lines[i].covariance[0, 0]])
        variance += float(np.trace(spread @ offsets @ spread.T)) / 2 / count
    return met, float(np.sqrt(variance))

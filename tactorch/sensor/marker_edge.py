"""Discs fitted to the edges of markers, by which dirt, hair and glare on a marker are recognized.

The edge of a marker is located on rays from its center. A disc, slightly elliptical, or the shape
in the reference is fitted to it by reweighted least squares. Rays that end elsewhere, at the edge
of a speck beside the marker or of glare on it, are outliers.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float

_RAYS = 48
_STEP_PX = 0.7  # of the samples on a ray
_REACH = 1.5  # length of a ray, in radii
_NO_EDGE_PX = 1e6
_CHECK, _SEARCH = 3, 12  # iterations for all markers, and for those that are not clean
_CENTER = 0.5  # prior deviation of a center, in radii
_SHAPE = np.array([0.15, 0.1, 0.1])  # that of the radius and of the ellipse
_MIN_SHAPE = np.array([0.03, 0.02, 0.02])  # that of markers beside which all have one shape
_MAX_SHAPE = 3.0  # deviation from the expected shape, over the prior deviation
_TOLERANCE, _MIN_TOLERANCE_PX = 0.08, 0.5  # of an edge from the disc, in radii
#: Share of the rays that end at the edge of a disc beside which nothing is.
CLEAN = 0.92
_MIN_EDGE = 0.55  # this share, from which the center is known
_MAX_GAP = 0.5  # of the circle without an edge: half a circle determines its center
_SIMILAR = 0.15  # difference of such shares below which discs fit as well
_MAX_MOVE = 1.3  # of a center in a fit, in radii
_TYPICAL, _USUAL = 80, 90  # percentiles of the markers that set the tolerance and usual shapes

_ANGLE = np.arange(_RAYS) * (2 * np.pi / _RAYS)
_DIRECTION = np.stack([np.cos(_ANGLE), np.sin(_ANGLE)], axis=1)
# Displacement, radius and ellipse.
_DESIGN = np.column_stack([_DIRECTION, np.ones(_RAYS), np.cos(2 * _ANGLE), np.sin(2 * _ANGLE)])
_PRODUCTS = (_DESIGN[:, :, None] * _DESIGN[:, None]).reshape(_RAYS, -1)

Points = Float[np.ndarray, "n 2"]
Edges = Float[np.ndarray, "n k"]


@dataclass(frozen=True, eq=False)
class MarkerDiscs:
    """Discs fitted to the edges of markers.

    Attributes:
        centers: Centers (column, row), px.
        shape: Deviation of radius and ellipse from those expected, in radii.
        edges: Distance of the edge from the center on each ray, px; infinite where there is none,
            NaN outside the image.
        deviation_px: Median deviation of the edge from the fitted one.
        share: Share of the rays in the image that end at the fitted edge.
        known: Whether this edge is long enough to determine the center.
    """

    centers: Points
    shape: Float[np.ndarray, "n 3"]
    edges: Edges
    deviation_px: Float[np.ndarray, " n"]
    share: Float[np.ndarray, " n"]
    known: Bool[np.ndarray, " n"]

    @property
    def clean(self) -> Bool[np.ndarray, " n"]:
        """Whether nearly all of the edge is that of the disc."""
        return np.asarray(self.known & (self.share >= CLEAN))

    def joined(self, other: "MarkerDiscs") -> "MarkerDiscs":
        """Return these discs and other ones."""
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return MarkerDiscs(*(np.concatenate(pair) for pair in pairs))

    def select(self, rows: np.ndarray) -> "MarkerDiscs":
        """Return the discs of some rows."""
        return MarkerDiscs(*(values[rows] for values in vars(self).values()))

    def apart(self, distance_px: float) -> "MarkerDiscs":
        """Return the known discs, of those that are close together the one with most edge."""
        order = np.argsort(-self.share, kind="stable")
        kept: list[int] = []
        for row in order[self.known[order]].tolist():
            gaps = np.linalg.norm(self.centers[kept] - self.centers[row], axis=1)
            if (gaps > distance_px).all():
                kept.append(row)
        return self.select(np.array(kept, dtype=int))


def circles(radius_px: float, count: int) -> Edges:
    """Return the outlines of equal circles, see `fit_discs`."""
    return np.full((count, _RAYS), radius_px)


def fit_discs(
    darkness: Float[np.ndarray, "h w"],
    centers: Points,
    outline: Edges,
    threshold: float,
    predicted: Points | None = None,
    population: int | None = None,
) -> tuple[MarkerDiscs, float]:
    """Fit the edges of markers of about these centers and outlines.

    `outline` is the distance of the expected edge from the center on each ray; NaN where it is not
    known. The edge is where the darkness falls below half of that at the center, or below the
    threshold. It belongs to the marker within a tolerance, px, that is returned too: it is larger
    where the edges of most markers deviate, as those of markers that are not round. Of two discs
    that fit as well, the one at the `predicted` center is preferred. The tolerance and the usual
    shapes are those of the first markers, the `population`; None for all.
    """
    if not len(centers):
        nothing = np.zeros(0)
        shape = np.zeros((0, 3))
        return MarkerDiscs(centers, shape, outline, nothing, nothing, nothing > 0), 0.0
    tolerance = max(_TOLERANCE * float(np.nanmedian(outline)), _MIN_TOLERANCE_PX)
    found = _fit(darkness, centers, outline, threshold, tolerance, _SHAPE, _CHECK)
    tolerance = max(tolerance, 3 * float(np.percentile(found.deviation_px[:population], _TYPICAL)))
    found = _fit(darkness, found.centers, outline, threshold, tolerance, _SHAPE, 1)
    usual, least = _SHAPE, -1.0
    if (round_ := found.clean[:population]).any():
        usual = np.percentile(np.abs(found.shape[:population][round_]), _USUAL, axis=0)
        usual = np.clip(usual, _MIN_SHAPE, _SHAPE)
    alike = (np.abs(found.shape) < _MAX_SHAPE * usual).all(axis=1)
    again = np.flatnonzero(~(found.clean & alike))
    for starts in (centers,) if predicted is None else (predicted, centers):
        if not len(again):
            break
        rows = (starts[again], outline[again])
        fit = _fit(darkness, *rows, threshold, tolerance, usual, _SEARCH)
        better = fit.share * fit.known > least
        for name, values in vars(found).items():
            values[again[better]] = getattr(fit, name)[better]
        least = found.share[again] * found.known[again] + _SIMILAR
    return found, tolerance


def _fit(
    darkness: np.ndarray, centers: Points, outline: Edges, threshold: float, tolerance: float,
    shape_deviation: np.ndarray, iterations: int,
) -> MarkerDiscs:  # fmt: skip
    radius, now = np.nanmean(outline, axis=1), centers.astype(float)
    fit = np.zeros((len(centers), 5))
    deviation = np.concatenate([[_CENTER, _CENTER], shape_deviation])
    prior = ((0.5 * tolerance / radius) ** 2)[:, None, None] * np.diag(deviation**-2)
    for iteration in range(iterations):
        excess = _edges(darkness, now, radius, threshold) - outline
        excess = np.nan_to_num(excess, nan=_NO_EDGE_PX, posinf=_NO_EDGE_PX)
        fit[:, :2] = 0.0
        # Tukey's weights, of a scale that is tightened.
        scale = tolerance * max(1.2, 6.0 - iteration)
        for _ in range(3):
            off = np.abs(excess - fit @ _DESIGN.T) / scale
            weight = np.maximum(1 - off**2, 0.0) ** 2
            normal = (weight @ _PRODUCTS).reshape(-1, 5, 5) + prior
            rhs = (weight * excess) @ _DESIGN
            fit = np.linalg.solve(normal, rhs[..., None])[..., 0]
        now = now + np.clip(fit[:, :2], -0.3 * radius[:, None], 0.3 * radius[:, None])
    edges, shape = _edges(darkness, now, radius, threshold), fit[:, 2:] / radius[:, None]
    off = np.abs(edges - outline - fit[:, 2:] @ _DESIGN[:, 2:].T)
    at_edge, expected = off < tolerance, ~np.isnan(off)
    share = at_edge.sum(axis=1) / np.maximum(expected.sum(axis=1), 1)
    known = (share >= _MIN_EDGE) & (_largest_gap(at_edge) <= _MAX_GAP)
    known &= (np.abs(shape) < _MAX_SHAPE * shape_deviation).all(axis=1)
    known &= np.linalg.norm(now - centers, axis=1) < _MAX_MOVE * radius
    typical = np.minimum(np.median(np.where(expected, off, np.inf), axis=1), radius)
    return MarkerDiscs(now, shape, edges, typical, share, known)


def _edges(darkness: np.ndarray, centers: Points, radius: np.ndarray, threshold: float) -> Edges:
    """Distance of the first edge on each ray; infinite if there is none, NaN outside the image."""
    count = int(np.ceil(_REACH * radius.max(initial=1.0) / _STEP_PX)) + 1
    along = np.arange(count) * _STEP_PX
    maps = (
        (centers[:, None, None, k] + _DIRECTION[:, k, None] * along).astype(np.float32)
        for k in (0, 1)
    )
    x, y = (values.reshape(-1, _RAYS * count) for values in maps)
    values: Any = cv2.remap(
        darkness.astype(np.float32), x, y, cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT, borderValue=-1.0,
    )  # fmt: skip
    values = values.reshape(-1, _RAYS, count)
    core = np.where((along < 0.5 * radius[:, None])[:, None], values, np.nan)
    level = np.maximum(0.5 * np.nanmedian(core, axis=(1, 2)), threshold)[:, None]
    below = values < level[..., None]
    first = np.maximum(below.argmax(axis=2), 1)[..., None]
    after, before = (np.take_along_axis(values, first - k, axis=2)[..., 0] for k in (0, 1))
    part = (before - level) / np.maximum(before - after, 1e-6)
    distance = (first[..., 0] - 1 + np.clip(part, 0.0, 1.0)) * _STEP_PX
    distance = np.where(below.any(axis=2) & ~below[..., 0], distance, np.inf)
    return np.where(after < 0, np.nan, distance)


def _largest_gap(at_edge: Bool[np.ndarray, "n k"]) -> Float[np.ndarray, " n"]:
    """Largest share of the circle in a row that has no edge."""
    position = np.arange(2 * _RAYS)
    last = np.maximum.accumulate(np.where(np.tile(at_edge, 2), position, -1), axis=1)
    return np.asarray(np.minimum((position - last).max(axis=1) / _RAYS, 1.0))

"""Markers on the gel: detection with subpixel accuracy, tracking, and displacements in mm.

A marker whose match is ambiguous is dropped from the frame rather than mismatched.
"""

import logging
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import center_of_mass, map_coordinates
from scipy.spatial import cKDTree

from tactorch.config import Options, option
from tactorch.errors import ConfigError
from tactorch.sensor.description import SensorDescription
from tactorch.sensor.frames import Image, image_fault
from tactorch.sensor.marker_edge import CLEAN, MarkerDiscs, circles, fit_discs
from tactorch.sensor.marker_match import (
    LOST_COST,
    SIMILAR_COST,
    Grid,
    assign_spots,
    match_markers,
    smooth_motion,
)

_log = logging.getLogger(__name__)

_MIN_BACKGROUND = 10.0  # gray values; below, contrast is not defined
_FLOW_LEVELS = 3
_JUMP = 0.25  # of a spacing between frames, above which identities are checked
_DOUBT = 0.04  # of the markers lost or spots left over, above which identities are checked
_ROUND = 0.85  # share of round spots, from which spots that are not are dirt, or partly covered
_ONE_SIZE = 0.1  # deviation of radii up to which markers are of one size
_MIN_UNLIKE_PX = 0.3  # difference of a position from that of the edge which is not noise
# Starts of fits about a spot that is no disc, in radii.
_AROUND = 0.7 * np.array(
    [(0, 0), (1, 0), (0.5, 0.9), (-0.5, 0.9), (-1, 0), (-0.5, -0.9), (0.5, -0.9)]
)
_FOUND = 0.7  # share of the edge of a marker without a spot
_TOTAL_DEVIATION = 2.5  # limit for the total displacement, over that for the step between frames

_Points = Float[np.ndarray, "_ 2"]
_Darkness = Float[np.ndarray, "_ _"]


@dataclass(frozen=True)
class MarkerAppearance(Options):
    """Appearance of markers in an image."""

    diameter_px: float = option(help="Diameter of a typical marker", unit="px", ge=2, le=200)
    min_area: float = option(
        0.25, "Smallest area of a marker, as a fraction of the typical area", gt=0, lt=1
    )
    max_area: float = option(
        6.0, "Largest area of a spot that may be several markers, over the typical area", gt=1
    )
    contrast: float | None = option(
        None, "Relative darkness at a marker's edge; null estimates it from the image", gt=0, lt=1
    )


def marker_appearance(
    sensor: SensorDescription, diameter_px: float | None = None
) -> MarkerAppearance | None:
    """Return the appearance of a sensor's markers; None for a sensor without markers."""
    if diameter_px is not None:
        return MarkerAppearance(diameter_px)
    if sensor.markers is None:
        return None
    x, y = sensor.mm_per_px
    return MarkerAppearance(sensor.markers.diameter_mm / (x * y) ** 0.5)


@dataclass(frozen=True)
class TrackOptions(Options):
    """Tolerances of marker tracking."""

    gate: float = option(
        0.35, "Largest distance of a spot from a predicted marker, in spacings", gt=0, lt=0.5
    )
    max_deviation: float = option(
        0.2, "Largest deviation of a step from the neighbors', in marker spacings", gt=0, lt=0.5
    )
    max_round_trip_px: float = option(
        0.5, "Largest error of optical flow followed forward and back", unit="px", gt=0
    )
    neighbors: int = option(8, "Number of neighbors that predict a marker's motion", ge=4)


def detect_markers(image: Image, appearance: MarkerAppearance) -> Float[np.ndarray, "n 2"]:
    """Return the centers (column, row) of the markers in an image, from the top down.

    Spots of several merged markers are split at their necks. Each center is the centroid of the
    darkness, which averages noise and partly covered pixels. Where most markers are round, one that
    is not, beside a speck of dirt or partly covered, has the center of the disc that fits its edge;
    if there is none, it is left out, with a warning.
    """
    centers, _, left_out = _detect(_relative_darkness(image, appearance), appearance)
    if left_out:
        _log.warning(
            "%d spots are left out: %d markers are found, but those are no whole discs",
            left_out, len(centers),
        )  # fmt: skip
    return centers


def marker_mask(image: Image, appearance: MarkerAppearance) -> Bool[np.ndarray, "h w"]:
    """Return the pixels of markers, including dirt of the same darkness."""
    darkness = _relative_darkness(image, appearance)
    return np.asarray(darkness > _threshold(darkness, appearance))


def _relative_darkness(image: Image, appearance: MarkerAppearance) -> _Darkness:
    """Return how much darker each pixel is than its surroundings: 0 as bright, 1 black.

    Markers are dark in every color, colored light is not. The brightest of the three colors is
    therefore compared with its median over a window that is wider than a marker.
    """
    if fault := image_fault(image):
        raise ConfigError(f"{fault}.")
    brightest = image.max(axis=2)
    size = 2 * round(0.7 * np.sqrt(appearance.max_area) * appearance.diameter_px) + 1
    margin = size // 2
    padded = cv2.copyMakeBorder(brightest, margin, margin, margin, margin, cv2.BORDER_REFLECT)
    background = cv2.medianBlur(padded, size)[margin:-margin, margin:-margin]
    smooth = cv2.GaussianBlur(brightest.astype(np.float32), (0, 0), 0.7)
    darkness = np.maximum(1.0 - smooth / np.maximum(background, _MIN_BACKGROUND), 0.0)
    return darkness.astype(np.float64)


def _threshold(darkness: _Darkness, appearance: MarkerAppearance) -> float:
    """Half the darkness of markers; Otsu's threshold fails where most pixels are background."""
    if appearance.contrast is not None:
        return appearance.contrast
    median = float(np.median(darkness))
    noise = 1.4826 * float(np.median(np.abs(darkness - median)))
    background = median + 6 * max(noise, 0.01)
    spots = darkness[darkness > background]
    return max(0.5 * float(np.percentile(spots, 75)), background) if len(spots) else 1.0


def _detect(darkness: _Darkness, appearance: MarkerAppearance) -> tuple[_Points, MarkerDiscs, int]:
    """Return the centers of the markers, their discs, and the number of spots left out."""
    threshold = _threshold(darkness, appearance)
    mask = np.asarray(darkness > threshold)
    labels = _label_spots(mask, appearance)
    spots = _centroids(darkness, labels, threshold)
    areas = np.bincount(labels.ravel())[1:]
    size = float(np.sqrt(np.median(areas[areas > 0]) / np.pi)) if len(spots) else 0.0
    discs, tolerance = fit_discs(darkness, spots, circles(size, len(spots)), threshold)
    clean = discs.clean
    if not clean.any() or clean.mean() < _ROUND:
        return spots, discs, 0
    if np.percentile(np.abs(discs.shape[clean, 0]), 75) > _ONE_SIZE:
        return spots, discs, 0
    off = np.linalg.norm(discs.centers - spots, axis=1)
    spots = np.where((clean & (off > _unlike(tolerance)))[:, None], discs.centers, spots)
    # Parts of spots that are no discs, and of spots too large for a marker, may be.
    size *= 1 + float(np.median(discs.shape[clean, 0]))
    around = spots[~clean][:, None] + _AROUND * size
    seeds = np.concatenate([around.reshape(-1, 2), _inner_points(mask, size)])
    seeds = seeds[cKDTree(spots[clean]).query(seeds)[0] > size]
    starts, count = np.concatenate([spots[clean], seeds]), int(clean.sum())
    outline = circles(size, len(starts))
    parts, _ = fit_discs(darkness, starts, outline, threshold, population=count)
    parts = parts.select(np.arange(count, len(starts))).apart(size)
    places = np.concatenate([spots[clean], parts.centers])
    left_out = int((cKDTree(places).query(spots[~clean])[0] > 2 * size).sum())
    order = np.lexsort(places.T)
    return places[order], discs.select(clean).joined(parts).select(order), left_out


def _unlike(tolerance_px: float) -> float:
    """Difference of a position from that of the edge which is not noise, px."""
    return max(_MIN_UNLIKE_PX, 0.5 * tolerance_px)


def _inner_points(mask: Bool[np.ndarray, "h w"], size_px: float) -> _Points:
    """Points (column, row) that are farthest inside, at least half of a radius."""
    from skimage.feature import peak_local_max

    depth = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5)
    smooth = cv2.GaussianBlur(depth, (0, 0), 1.0)
    step = max(1, round(0.5 * size_px))
    peaks = peak_local_max(smooth, min_distance=step, threshold_abs=0.5 * size_px)
    return np.asarray(peaks[:, ::-1], dtype=float)


def _label_spots(
    mask: Bool[np.ndarray, "h w"], appearance: MarkerAppearance
) -> Int[np.ndarray, "h w"]:
    """Label the spots that may be markers, from 1."""
    # Bright specks within a marker must not split it.
    size = max(1, round(0.3 * appearance.diameter_px))
    kernel = np.ones((size, size), np.uint8)
    closed = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, kernel)
    count, labels, statistics, _ = cv2.connectedComponentsWithStats(closed, connectivity=4)
    areas = statistics[:, cv2.CC_STAT_AREA] / (np.pi / 4 * appearance.diameter_px**2)
    accepted = (areas >= appearance.min_area) & (areas <= appearance.max_area)
    accepted[0] = False
    labels = np.where(accepted[labels], labels, 0)
    for label in np.flatnonzero(accepted & (areas > 1.6)):
        left, top, width, height = (int(v) for v in statistics[label, :4])
        window = labels[top : top + height, left : left + width]
        pieces = _split_spot(window == label, appearance.diameter_px)
        window[pieces > 1] = pieces[pieces > 1] - 2 + count
        count += max(0, pieces.max() - 1)
    return labels


def _split_spot(spot: Bool[np.ndarray, "h w"], diameter_px: float) -> Int[np.ndarray, "h w"]:
    """Label the pieces of a spot with necks from 1; 0 for a spot without."""
    from skimage.feature import peak_local_max
    from skimage.segmentation import watershed

    whole = np.zeros(spot.shape, dtype=np.int32)
    distance = cv2.distanceTransform(np.pad(spot, 1).astype(np.uint8), cv2.DIST_L2, 5)[1:-1, 1:-1]
    smooth = cv2.GaussianBlur(distance, (0, 0), 1.0)
    min_distance = max(2, round(0.45 * diameter_px))
    peaks = peak_local_max(smooth, min_distance=min_distance, labels=spot.astype(int))
    if len(peaks) < 2:
        return whole
    seeds = whole.copy()
    seeds[tuple(peaks.T)] = np.arange(1, len(peaks) + 1)
    pieces = watershed(-smooth, seeds, mask=spot)
    # A neck is clearly narrower than the pieces are at their centers.
    horizontal = (pieces[:, 1:] != pieces[:, :-1]) & (pieces[:, 1:] > 0) & (pieces[:, :-1] > 0)
    vertical = (pieces[1:] != pieces[:-1]) & (pieces[1:] > 0) & (pieces[:-1] > 0)
    border = np.concatenate([distance[:, 1:][horizontal], distance[1:][vertical]])
    has_necks = len(border) and border.max() < 0.8 * distance[tuple(peaks.T)].min()
    return pieces if has_necks else whole


def _centroids(darkness: _Darkness, labels: Int[np.ndarray, "h w"], threshold: float) -> _Points:
    """Centroids of the darkness in excess of half the threshold, in and next to each spot."""
    dilated = cv2.dilate(labels.astype(np.float32), np.ones((3, 3), np.uint8)).astype(np.int64)
    dilated = np.where(labels > 0, labels, dilated)
    weight = np.maximum(darkness - 0.5 * threshold, 0.0)
    spots = np.unique(dilated[(weight > 0) & (dilated > 0)])
    centers = np.array(center_of_mass(weight, dilated, spots)).reshape(-1, 2)
    return centers[np.lexsort(centers.T[::-1])][:, ::-1]


@dataclass(eq=False)
class MarkerTracker:
    """Tracker of the markers of a reference image from frame to frame.

    The position of a marker is predicted by optical flow and by the motion of its neighbors. Each
    detected spot near a predicted position is assigned to one marker. A match is accepted if its
    displacement agrees with a robust affine fit to the displacements of the neighbors. A lost
    marker may be found again in a later frame.

    After a jump, or where markers or spots are left over, the markers are assigned again from the
    reference alone (`tactorch.sensor.marker_match`), and the better assignment is used. Markers
    whose assignment is ambiguous then are not seen.

    Attributes:
        reference: Image of the gel without contact.
        reference_px: Markers in the reference (column, row).
        spacing_px: Median distance of neighboring markers.
        neighbors: Indices of each marker's neighbors.
        left_out: Number of spots in the reference that are no markers, or only parts.
        ambiguous: Markers of the last frame that were not seen because other assignments of spots
            are as good.
        covered: Markers of the last frame that are covered, or beside dirt. Their positions are
            those of the visible part of the edge, or NaN if that is too short.
        unlike: Number of markers of the last frame that do not look as in the reference, where
            these are too many to recognize and correct single ones; 0 where they are few.
        reassigned: Whether the markers of the last frame were assigned from the reference.

    Raises:
        ConfigError: The reference shows too few markers.
    """

    reference: Image
    appearance: MarkerAppearance
    options: TrackOptions = field(default_factory=TrackOptions)

    def __post_init__(self) -> None:
        self._darkness = _relative_darkness(self.reference, self.appearance)
        self.reference_px, self._discs, self.left_out = _detect(self._darkness, self.appearance)
        required = self.options.neighbors + 1
        if len(self.reference_px) < required:
            raise ConfigError(
                f"{len(self.reference_px)} markers were found in the reference, and {required} are"
                f" needed to track them; is diameter_px={self.appearance.diameter_px:g} right?"
            )
        distance, nearest = cKDTree(self.reference_px).query(self.reference_px, k=required)
        self.spacing_px = float(np.median(distance[:, 1]))
        self.neighbors = nearest[:, 1:]
        size_px = self.reference.shape[1], self.reference.shape[0]
        gate = self.options.gate
        self._grid = Grid(self.reference_px, self.neighbors, self.spacing_px, size_px, gate)
        self._confirmed_cost = 0.0  # cost of the last assignment that was confirmed
        self.ambiguous, self.covered, self._lost = np.zeros((3, len(self.reference_px)), dtype=bool)
        # Edges that are not seen in the reference are not expected in frames.
        edges = self._discs.edges
        self._checked = np.isfinite(edges).mean(axis=1) >= CLEAN
        edges = np.where(np.isfinite(edges), edges, np.nan)
        self._outline = np.where(self._checked[:, None], edges, self.appearance.diameter_px / 2)
        self.reassigned, self.unlike = False, 0
        self._previous_px = self.reference_px.copy()  # measured, or predicted for lost markers
        self._previous_image = self.reference

    @property
    def fault(self) -> str:
        """Description of the markers of the last frame that are not distinguished, or covered."""
        unsure, covered = int(self.ambiguous.sum()), int(self.covered.sum())
        lost = int((self.covered & self._lost).sum())
        parts, count = [], len(self.ambiguous)
        if self._lost.all() and not unsure:
            parts.append("no marker is found")
        if self.unlike:
            parts.append(
                f"{self.unlike} of {count} markers do not look as in the reference: covered, dirty"
                " or blurred, and not corrected"
            )
        if unsure:
            parts.append(f"{unsure} of {count} markers cannot be distinguished")
        if covered:
            parts.append(
                f"{covered} of {count} markers are covered or beside dirt, {lost} of them dropped"
            )
        return "; ".join(parts)

    def track(self, image: Image | None) -> Float[np.ndarray, "n 2"]:
        """Return the markers in the next rectified frame (column, row); NaN for those not seen.

        No marker is seen in a missing frame, None.
        """
        self.ambiguous, self.covered, self._lost = np.zeros((3, len(self.reference_px)), dtype=bool)
        self.unlike = 0
        if image is None:
            return np.full(self.reference_px.shape, np.nan)
        if image.shape != self.reference.shape:
            raise ConfigError(
                f"the frame has shape {image.shape}, the reference {self.reference.shape}; give"
                " rectified frames of one sensor."
            )
        darkness = _relative_darkness(image, self.appearance)
        threshold = _threshold(darkness, self.appearance)
        labels = _label_spots(np.asarray(darkness > threshold), self.appearance)
        spots = _centroids(darkness, labels, threshold)
        gate = self.options.gate * self.spacing_px
        predicted = self._previous_px + self._flow(image)
        positions = self._reject_outliers(assign_spots(predicted, spots, gate))
        # A lost marker may be a remaining spot where its neighbors' total displacement puts it.
        lost = np.isnan(positions)
        if lost.any():
            predicted = np.where(lost, self._by_neighbors(positions, self.reference_px), positions)
            candidates = assign_spots(predicted, spots, gate)
            positions = self._reject_outliers(np.where(lost, candidates, positions))
        positions = self._check_identities(positions, spots)
        origin = self.reference_px if self.reassigned else self._previous_px
        fallback = self._by_neighbors(positions, origin)
        positions = self._refine(positions, darkness)
        positions = self._check_edges(positions, fallback, darkness, threshold)
        self._previous_px = np.where(np.isnan(positions), fallback, positions)
        self._previous_image, self._lost = image, np.isnan(positions[:, 0])
        return positions

    def _check_identities(self, positions: _Points, spots: _Points) -> _Points:
        """Assign the markers from the reference if the tracked assignment is in doubt."""
        self.reassigned, self.ambiguous = False, np.zeros(len(positions), dtype=bool)
        steps = np.linalg.norm(positions - self._previous_px, axis=1) / self.spacing_px
        jumped = not np.isfinite(steps).any() or float(np.nanmax(steps)) > _JUMP
        cost = self._grid.cost(positions, spots)
        allowed = _DOUBT * LOST_COST * len(positions)
        if not jumped and cost <= max(allowed, self._confirmed_cost + allowed):
            return positions
        match = match_markers(self._grid, spots, [positions])
        # Of assignments that are as good, the motion since the last frame decides, if it is small.
        if not jumped and cost <= match.cost + SIMILAR_COST:
            self._confirmed_cost = cost
            return positions
        apart = np.linalg.norm(match.positions - positions, axis=1)
        self.reassigned = bool(np.nan_to_num(apart).max() > 0.3 * self.spacing_px)
        self.ambiguous = match.ambiguous
        self._confirmed_cost = 0.0 if self.ambiguous.all() else match.cost
        return np.where(self.ambiguous[:, None], np.nan, match.positions)

    def _check_edges(
        self, positions: _Points, predicted: _Points, darkness: _Darkness, threshold: float
    ) -> _Points:
        """Measure markers whose edge is partly that of dirt or glare by the rest of it.

        A marker without enough of its edge is dropped. A marker without a spot may be part of a
        larger one.
        """
        seen, checked = np.isfinite(positions[:, 0]), self._checked
        starts = np.where(seen[:, None], positions, predicted)
        discs, tolerance = fit_discs(darkness, starts, self._outline, threshold, predicted)
        usual = checked & seen & discs.clean
        if usual.sum() <= _ROUND * (checked & seen).sum():  # nothing is known of single markers
            self.unlike = int((checked & seen).sum() - usual.sum())
            return positions
        by_edge = self.reference_px + discs.centers - self._discs.centers
        off = np.linalg.norm(by_edge - starts, axis=1)
        differs = off > max(_unlike(tolerance), 4 * float(np.median(off[usual])))
        found = ~seen & ~self.ambiguous & checked & discs.known & (discs.share >= _FOUND)
        found &= off < self.options.max_deviation * self.spacing_px
        measured = found | (seen & checked & discs.known & differs)
        # Where the image ends, the edge that is missing is no sign of dirt.
        whole = (~np.isnan(discs.edges)).mean(axis=1) >= CLEAN
        hidden = seen & checked & whole & ~discs.known
        lost = ~seen & ~self.ambiguous & self._grid.inside(predicted)
        self.covered = hidden | measured | lost
        return np.where(hidden[:, None], np.nan, np.where(measured[:, None], by_edge, positions))

    def _flow(self, image: Image) -> _Points:
        """Pyramidal Lucas-Kanade flow (Bouguet, 2001), smoothed over the neighbors."""
        side = 2 * round(self.appearance.diameter_px) + 1
        first, second = self._previous_image.max(axis=2), image.max(axis=2)
        settings: Any = {"winSize": (side, side), "maxLevel": _FLOW_LEVELS, "nextPts": None}
        start = self._previous_px.astype(np.float32)[:, None]
        forward, found, _ = cv2.calcOpticalFlowPyrLK(first, second, start, **settings)
        backward, returned, _ = cv2.calcOpticalFlowPyrLK(second, first, forward, **settings)
        closed = np.linalg.norm(backward - start, axis=2) <= self.options.max_round_trip_px
        reliable = (found == 1) & (returned == 1) & closed
        step = np.where(reliable, forward[:, 0].astype(np.float64) - self._previous_px, np.nan)
        return smooth_motion(self._previous_px, step, self.neighbors)

    def _reject_outliers(self, positions: _Points) -> _Points:
        """Drop positions that deviate from the motion of the neighbors, the largest first.

        The limit is strict for the step and loose for the total displacement, which varies more
        from marker to marker.
        """
        positions = positions.copy()
        limit = self.options.max_deviation * self.spacing_px
        for _ in range(len(positions)):
            by_step = self._by_neighbors(positions, self._previous_px)
            by_total = self._by_neighbors(positions, self.reference_px)
            step = np.linalg.norm(positions - by_step, axis=1)
            total = np.linalg.norm(positions - by_total, axis=1)
            deviation = np.nan_to_num(np.maximum(step, total / _TOTAL_DEVIATION), nan=0.0)
            worst = int(np.argmax(deviation))
            if deviation[worst] <= limit:
                break
            positions[worst] = np.nan
        return positions

    def _by_neighbors(self, positions: _Points, origin: _Points) -> _Points:
        """Positions by the neighbors' motion since the last frame or since the reference."""
        return origin + smooth_motion(self.reference_px, positions - origin, self.neighbors)

    def _refine(self, positions: _Points, darkness: _Darkness) -> _Points:
        """Register the patch around each marker to that in the reference.

        Comparing patches is less noisy than comparing centroids. A correction of more than a fifth
        of a marker is not applied.
        """
        known = ~np.isnan(positions[:, 0])
        if not known.any():
            return positions
        diameter = self.appearance.diameter_px
        side = 2 * round(0.8 * diameter) + 1
        first, second = (
            (255 * np.clip(d, 0, 1)).astype(np.uint8) for d in (self._darkness, darkness)
        )
        start = self.reference_px[known].astype(np.float32)[:, None]
        guess = positions[known].astype(np.float32)[:, None]
        registered, success, _ = cv2.calcOpticalFlowPyrLK(
            first, second, start, guess.copy(),
            winSize=(side, side), maxLevel=0, flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
            criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 0.002),
        )  # fmt: skip
        correction = np.linalg.norm(registered - guess, axis=2)
        accepted = (success == 1) & (correction < 0.2 * diameter)
        refined = positions.copy()
        refined[known] = np.where(accepted, registered[:, 0], positions[known])
        return refined


def marker_displacements(
    sensor: SensorDescription,
    reference_px: Float[np.ndarray, "n 2"],
    positions_px: Float[np.ndarray, "n 2"],
    height_mm: Float[np.ndarray, "h w"] | None = None,
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Return rest positions and displacements of markers on the outer face, sensor frame, mm.

    The projection is orthographic along z, with a uniform pixel size. Markers that are not seen
    have NaN as position in the frame and as displacement. `height_mm` is the displacement of the
    face along z, negative in contact; None for zero.
    """
    rest, current = sensor.to_mm(reference_px), sensor.to_mm(positions_px)
    rest_height = sensor.gel.height_mm(rest)
    rise = np.zeros(len(rest))
    if height_mm is not None:
        if height_mm.shape != sensor.shape:
            raise ConfigError(f"heights are {height_mm.shape}, images {sensor.shape}.")
        known = np.isfinite(positions_px).all(axis=1)
        columns, rows = positions_px[known].T
        # The height is that at the marker's current position, which at rest was another point.
        rise[known] = map_coordinates(height_mm, [rows, columns], order=1, mode="nearest")
        rise[known] += sensor.gel.height_mm(current[known]) - rest_height[known]
    displacements = np.column_stack([current - rest, rise])
    displacements[~np.isfinite(displacements).all(axis=1)] = np.nan
    return np.column_stack([rest, rest_height]), displacements

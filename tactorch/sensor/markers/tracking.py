"""Tracking of markers through a sequence, and their displacements in mm.

A marker whose match is ambiguous is dropped from the frame rather than mismatched.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import map_coordinates
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from tactorch.config import Options, option
from tactorch.errors import ConfigError
from tactorch.sensor.description import SensorDescription
from tactorch.sensor.frames import Image
from tactorch.sensor.markers.detection import MarkerAppearance, locate_markers, relative_darkness

_FLOW_LEVELS = 3
_TOTAL_DEVIATION = 2.5  # limit for the total displacement, over that for the step between frames


@dataclass(frozen=True)
class TrackOptions(Options):
    """Tolerances of marker tracking."""

    gate: float = option(
        0.35, "Largest distance of a spot from a marker's predicted position, in marker spacings",
        gt=0, lt=0.5,
    )  # fmt: skip
    max_deviation: float = option(
        0.2, "Largest deviation of a marker's step from its neighbors', in marker spacings",
        gt=0, lt=0.5,
    )  # fmt: skip
    max_round_trip_px: float = option(
        0.5, "Largest error of optical flow followed forward and back", unit="px", gt=0
    )
    neighbors: int = option(8, "Number of neighbors that predict a marker's motion", ge=4)


@dataclass(eq=False)
class MarkerTracker:
    """Tracker of the markers of a reference image from frame to frame.

    The position of a marker is predicted by optical flow and by the motion of its neighbors. Each
    detected spot near a predicted position is assigned to one marker. A match is accepted if its
    displacement agrees with a robust affine fit to the displacements of the neighbors. A lost
    marker may be found again in a later frame.

    Args:
        reference: Image of the gel without contact.
        appearance: Appearance of the markers.
        options: Tolerances.

    Attributes:
        reference_px: Markers in the reference (column, row).
        spacing_px: Median distance of neighboring markers.
        neighbors: Indices of each marker's neighbors.

    Raises:
        ConfigError: The reference shows too few markers.
    """

    reference: Image
    appearance: MarkerAppearance
    options: TrackOptions = field(default_factory=TrackOptions)

    def __post_init__(self) -> None:
        self._darkness = relative_darkness(self.reference, self.appearance)
        self.reference_px = locate_markers(self._darkness, self.appearance)
        required = self.options.neighbors + 1
        if len(self.reference_px) < required:
            raise ConfigError(
                f"{len(self.reference_px)} markers were found in the reference, and {required} are"
                f" needed to track them; is diameter_px={self.appearance.diameter_px:g} right?"
            )
        distance, nearest = cKDTree(self.reference_px).query(self.reference_px, k=required)
        self.spacing_px = float(np.median(distance[:, 1]))
        self.neighbors = nearest[:, 1:]
        self._previous_px = self.reference_px.copy()  # measured, or predicted for lost markers
        self._previous_image = self.reference

    def track(self, image: Image) -> Float[np.ndarray, "n 2"]:
        """Return the markers in the next frame (column, row); NaN for markers that are not seen.

        Raises:
            ConfigError: The frame has another size than the reference.
        """
        if image.shape != self.reference.shape:
            raise ConfigError(
                f"the frame has shape {image.shape}, the reference {self.reference.shape}; give"
                " rectified frames of one sensor."
            )
        darkness = relative_darkness(image, self.appearance)
        spots = locate_markers(darkness, self.appearance)
        gate = self.options.gate * self.spacing_px
        positions = self._reject_outliers(_assign_spots(self._predicted(image), spots, gate))
        # A lost marker may be a remaining spot where its neighbors' total displacement puts it.
        lost = np.isnan(positions[:, 0])
        if lost.any():
            predicted = np.where(lost[:, None], self._by_total_motion(positions), positions)
            candidates = _assign_spots(predicted, spots, gate)
            merged = np.where(lost[:, None], candidates, positions)
            positions = self._reject_outliers(merged)
        fallback = self._by_last_step(positions)
        positions = _refine_positions(
            self._darkness, darkness, self.reference_px, positions, self.appearance.diameter_px
        )
        self._previous_px = np.where(np.isnan(positions), fallback, positions)
        self._previous_image = image
        return positions

    def _predicted(self, image: Image) -> Float[np.ndarray, "n 2"]:
        """Positions by optical flow, smoothed over the neighbors."""
        diameter, limit = self.appearance.diameter_px, self.options.max_round_trip_px
        moved, reliable = _optical_flow(
            self._previous_image, image, self._previous_px, diameter, limit
        )
        step = np.where(reliable[:, None], moved - self._previous_px, np.nan)
        return self._previous_px + _smooth_motion(self._previous_px, step, self.neighbors)

    def _reject_outliers(self, positions: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Drop positions that deviate from the motion of the neighbors, the largest first.

        The limit is strict for the step and loose for the total displacement, which varies more
        from marker to marker.
        """
        positions = positions.copy()
        limit = self.options.max_deviation * self.spacing_px
        for _ in range(len(positions)):
            step = np.linalg.norm(positions - self._by_last_step(positions), axis=1)
            total = np.linalg.norm(positions - self._by_total_motion(positions), axis=1)
            deviation = np.nan_to_num(np.maximum(step, total / _TOTAL_DEVIATION), nan=0.0)
            worst = int(np.argmax(deviation))
            if deviation[worst] <= limit:
                break
            positions[worst] = np.nan
        return positions

    def _by_last_step(self, positions: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Positions by the neighbors' motion since the last frame."""
        motion = positions - self._previous_px
        return self._previous_px + _smooth_motion(self.reference_px, motion, self.neighbors)

    def _by_total_motion(self, positions: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Positions by the neighbors' motion since the reference."""
        motion = positions - self.reference_px
        return self.reference_px + _smooth_motion(self.reference_px, motion, self.neighbors)


def track_markers(
    frames: Iterable[Image | None],
    reference: Image,
    appearance: MarkerAppearance,
    options: TrackOptions | None = None,
) -> Iterator[Float[np.ndarray, "n 2"]]:
    """Yield the markers of each frame (column, row); all are NaN for a missing frame.

    Args:
        frames: Rectified frames; None for a missing one.
        reference: Image of the gel without contact.
        appearance: Appearance of the markers.
        options: Tolerances.

    Yields:
        Positions in the order of the reference.

    Raises:
        ConfigError: The reference shows too few markers, or a frame has another size.
    """
    tracker = MarkerTracker(reference, appearance, options or TrackOptions())
    for image in frames:
        missing = np.full(tracker.reference_px.shape, np.nan)
        yield missing if image is None else tracker.track(image)


def marker_displacements(
    sensor: SensorDescription,
    reference_px: Float[np.ndarray, "n 2"],
    positions_px: Float[np.ndarray, "n 2"],
    height_mm: Float[np.ndarray, "h w"] | None = None,
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Return rest positions and displacements of markers on the outer face, sensor frame, mm.

    The projection is orthographic along z, with a uniform pixel size.

    Args:
        sensor: Sensor description.
        reference_px: Markers in the reference (column, row).
        positions_px: The same markers in a frame; NaN for markers that are not seen.
        height_mm: Displacement of the face along z, negative in contact; None for zero.

    Returns:
        Rest positions, and displacements with NaN for markers that are not seen.

    Raises:
        ConfigError: `height_mm` and the image have different sizes.
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


def _optical_flow(
    first: Image,
    second: Image,
    positions: Float[np.ndarray, "n 2"],
    diameter_px: float,
    max_round_trip_px: float,
) -> tuple[Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
    """Pyramidal Lucas-Kanade flow (Bouguet, 2001), and whether its round trip closes."""
    import cv2

    size = 2 * round(diameter_px) + 1
    gray_first, gray_second = (image.max(axis=2) for image in (first, second))
    start = positions.astype(np.float32)[:, None]
    output: Any = None  # allocated by OpenCV
    forward, forward_ok, _ = cv2.calcOpticalFlowPyrLK(
        gray_first, gray_second, start, output, winSize=(size, size), maxLevel=_FLOW_LEVELS
    )
    backward, backward_ok, _ = cv2.calcOpticalFlowPyrLK(
        gray_second, gray_first, forward, output, winSize=(size, size), maxLevel=_FLOW_LEVELS
    )
    round_trip = np.linalg.norm((backward - start)[:, 0], axis=1)
    closed = round_trip <= max_round_trip_px
    reliable = (forward_ok[:, 0] == 1) & (backward_ok[:, 0] == 1) & closed
    return forward[:, 0].astype(np.float64), np.asarray(reliable)


def _refine_positions(
    reference_darkness: Float[np.ndarray, "h w"],
    darkness: Float[np.ndarray, "h w"],
    reference_px: Float[np.ndarray, "n 2"],
    positions: Float[np.ndarray, "n 2"],
    diameter_px: float,
) -> Float[np.ndarray, "n 2"]:
    """Register the patch around each marker to that in the reference.

    Comparing patches is less noisy than comparing centroids. A correction of more than a fifth of a
    marker is not applied.
    """
    import cv2

    known = ~np.isnan(positions[:, 0])
    if not known.any():
        return positions
    size = 2 * round(0.8 * diameter_px) + 1
    first, second = (
        (255 * np.clip(d, 0, 1)).astype(np.uint8) for d in (reference_darkness, darkness)
    )
    guess = positions[known].astype(np.float32)[:, None]
    registered, success, _ = cv2.calcOpticalFlowPyrLK(
        first, second, reference_px[known].astype(np.float32)[:, None], guess.copy(),
        winSize=(size, size), maxLevel=0, flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 0.002),
    )  # fmt: skip
    correction = np.linalg.norm((registered - guess)[:, 0], axis=1)
    accepted = (success[:, 0] == 1) & (correction < 0.2 * diameter_px)
    refined = positions.copy()
    refined[known] = np.where(accepted[:, None], registered[:, 0], positions[known])
    return refined


def _assign_spots(
    predicted: Float[np.ndarray, "n 2"], spots: Float[np.ndarray, "k 2"], gate: float
) -> Float[np.ndarray, "n 2"]:
    """Assign each marker at most one spot within the gate, minimizing squared distances."""
    positions = np.full(predicted.shape, np.nan)
    if not len(spots):
        return positions
    distance = np.linalg.norm(predicted[:, None] - spots[None], axis=2)
    # A constant cost beyond the gate: a marker without a spot does not displace another's match.
    rows, columns = linear_sum_assignment(np.minimum(distance, gate) ** 2)
    accepted = distance[rows, columns] < gate
    positions[rows[accepted]] = spots[columns[accepted]]
    return positions


def _smooth_motion(
    positions: Float[np.ndarray, "n 2"],
    motion: Float[np.ndarray, "n 2"],
    neighbors: np.ndarray,
) -> Float[np.ndarray, "n 2"]:
    """Motion of each marker predicted by robust affine fits to its neighbors' motion."""
    known = ~np.isnan(motion[:, 0])
    if not known.any():
        return np.zeros_like(motion)
    median = np.median(motion[known], axis=0)
    return np.stack(
        [
            _affine_prediction(positions[nearest], motion[nearest], positions[i], median)
            for i, nearest in enumerate([row[known[row]] for row in neighbors])
        ]
    )


def _affine_prediction(
    positions: Float[np.ndarray, "k 2"],
    motion: Float[np.ndarray, "k 2"],
    target: Float[np.ndarray, "2"],
    default: Float[np.ndarray, "2"],
) -> Float[np.ndarray, "2"]:
    """Fit an affine displacement by reweighted least squares and evaluate it at the target."""
    if len(positions) == 0:
        return default
    if len(positions) < 4:
        return np.median(motion, axis=0)
    offset = positions - target
    scale = float(np.abs(offset).max())
    design = np.column_stack([np.ones(len(positions)), offset / scale])
    weight = np.ones(len(positions))
    ridge = np.diag([0.0, 0.05, 0.05])  # neighbors on a line determine one slope only
    for _ in range(4):
        normal = design.T @ (weight[:, None] * design) + ridge
        fit = np.linalg.solve(normal, design.T @ (weight[:, None] * motion))
        residual = np.linalg.norm(motion - design @ fit, axis=1)
        spread = max(float(np.median(residual)), 0.1)
        weight = 1.0 / (1.0 + (residual / (2.0 * spread)) ** 2)
    return fit[0]

"""Following markers through a sequence: never a wrong arrow, rather none."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from tactorch.errors import ConfigError
from tactorch.sensor.frames import Image
from tactorch.sensor.markers.detect import MarkerLook, darkness, markers_in
from tactorch.sensor.markers.flow import followed, sharpened

_LOOSER = 2.5  # so many times as far may a whole motion stray as a step


@dataclass(frozen=True)
class TrackOptions:
    """How strictly markers are followed.

    Attributes:
        gate: Distance of a spot from where a marker is expected, in distances between markers, up
            to which it may be that marker.
        stray: Distance of a marker's step from what its neighbours' tell, in distances
            between markers, from which on it is not believed.
        back_px: Distance from its beginning to where a marker comes out that is followed forward
            and back, from which on it is not believed.
        neighbours: That tell how a marker moves.
    """

    gate: float = 0.35
    stray: float = 0.2
    back_px: float = 0.5
    neighbours: int = 8

    def __post_init__(self) -> None:
        if not (0 < self.gate < 0.5 and 0 < self.stray < 0.5 and self.back_px > 0):
            raise ConfigError(
                f"gate={self.gate:g}, stray={self.stray:g} must lie between 0 and 0.5, and"
                f" back_px={self.back_px:g} above 0."
            )
        if self.neighbours < 4:
            raise ConfigError(f"neighbours={self.neighbours} must be at least 4.")


@dataclass(frozen=True, eq=False)
class Tracked:
    """Markers in a frame, in the order of the reference.

    Attributes:
        places: Their centres (column, row), px; NaN where a marker is not seen.
        valid: Which are seen.
    """

    places: Float[np.ndarray, "n 2"]
    valid: Bool[np.ndarray, " n"]


@dataclass(eq=False)
class MarkerTracker:
    """Follows the markers of a reference image from frame to frame.

    A marker is expected where optical flow takes it, or its neighbours. It is where a dark spot is
    near that place, each spot being one marker; and it is believed where its displacement agrees
    with that of its neighbours (an affine map of theirs, fitted robustly). One that is lost may be
    found again.

    Args:
        reference: The gel without contact.
        look: How markers look.
        options: How strictly they are followed.

    Raises:
        ConfigError: The reference shows too few markers.
    """

    reference: Image
    look: MarkerLook
    options: TrackOptions = field(default_factory=TrackOptions)

    def __post_init__(self) -> None:
        self._dark = darkness(self.reference, self.look)
        self.begin = markers_in(self._dark, self.look)
        least = self.options.neighbours + 1
        if len(self.begin) < least:
            raise ConfigError(
                f"{len(self.begin)} markers were found in the reference, and {least} are needed to"
                f" follow them; is diameter_px={self.look.diameter_px:g} right?"
            )
        tree = cKDTree(self.begin)
        distance, near = tree.query(self.begin, k=least)
        self.pitch = float(np.median(distance[:, 1]))
        self.near = near[:, 1:]
        self._last = self.begin.copy()  # where each was last, or must be by its neighbours
        self._before = self.reference

    def follow(self, image: Image) -> Tracked:
        """Return the markers in the next frame.

        Raises:
            ConfigError: The frame has another size than the reference.
        """
        if image.shape != self.reference.shape:
            raise ConfigError(
                f"the frame has shape {image.shape}, the reference {self.reference.shape}; give"
                " rectified frames of one sensor."
            )
        expected = self._expected(image)
        dark = darkness(image, self.look)
        spots = markers_in(dark, self.look)
        gate = self.options.gate * self.pitch
        places = self._believed(_matched(expected, spots, gate))
        # What was lost may be a spot that is left where its neighbours' whole motion tells.
        lost = np.isnan(places[:, 0])
        if lost.any():
            told = np.where(lost[:, None], self._by_neighbours(places), places)
            again = _matched(told, spots, gate)
            places = self._believed(np.where(lost[:, None], again, places))
        guesses = self._step_on(places)
        places = sharpened(self._dark, dark, self.begin, places, self.look.diameter_px)
        valid = ~np.isnan(places[:, 0])
        self._last = np.where(valid[:, None], places, guesses)
        self._before = image
        return Tracked(places, valid)

    def _expected(self, image: Image) -> Float[np.ndarray, "n 2"]:
        """Where flow takes each marker; where flow is not to be trusted, its neighbours' motion."""
        moved, sure = followed(
            self._before, image, self._last, self.look.diameter_px, self.options.back_px
        )
        step = np.where(sure[:, None], moved - self._last, np.nan)
        step = _smoothed(self._last, step, self.near)
        return self._last + step

    def _believed(self, places: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Take back what does not move as its neighbours do, the worst first.

        A step is compared strictly, the whole motion loosely, for it bends more from marker to
        marker.
        """
        places = places.copy()
        limit = self.options.stray * self.pitch
        for _ in range(len(places)):
            step = np.linalg.norm(places - self._step_on(places), axis=1)
            whole = np.linalg.norm(places - self._by_neighbours(places), axis=1)
            off = np.nan_to_num(np.maximum(step, whole / _LOOSER), nan=0.0)
            worst = int(np.argmax(off))
            if off[worst] <= limit:
                break
            places[worst] = np.nan
        return places

    def _step_on(self, places: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Where each is by its neighbours' motion since the last frame."""
        return self._last + _smoothed(self.begin, places - self._last, self.near)

    def _by_neighbours(self, places: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Where each is by its neighbours' motion since the reference."""
        return self.begin + _smoothed(self.begin, places - self.begin, self.near)


def track(
    frames: Iterable[Image | None],
    reference: Image,
    look: MarkerLook,
    options: TrackOptions | None = None,
) -> Iterator[Tracked]:
    """Yield the markers of each frame; a frame that is missing has none.

    Raises:
        ConfigError: The reference shows too few markers, or a frame has another size.
    """
    tracker = MarkerTracker(reference, look, options or TrackOptions())
    for image in frames:
        if image is None:
            none = np.full(tracker.begin.shape, np.nan)
            yield Tracked(none, np.zeros(len(none), dtype=bool))
        else:
            yield tracker.follow(image)


def _matched(
    expected: Float[np.ndarray, "n 2"], spots: Float[np.ndarray, "k 2"], gate: float
) -> Float[np.ndarray, "n 2"]:
    """Give each marker a spot of its own, none farther than the gate, all as near as can be."""
    found = np.full(expected.shape, np.nan)
    if not len(spots):
        return found
    distance = np.linalg.norm(expected[:, None] - spots[None], axis=2)
    # Beyond the gate every place is as bad, so that no marker is pushed off its spot by one that
    # has none.
    rows, columns = linear_sum_assignment(np.minimum(distance, gate) ** 2)
    good = distance[rows, columns] < gate
    found[rows[good]] = spots[columns[good]]
    return found


def _smoothed(
    places: Float[np.ndarray, "n 2"],
    moved: Float[np.ndarray, "n 2"],
    near: np.ndarray,
) -> Float[np.ndarray, "n 2"]:
    """How each should move by its neighbours: an affine map fitted to theirs, robustly."""
    known = ~np.isnan(moved[:, 0])
    if not known.any():
        return np.zeros_like(moved)
    overall = np.median(moved[known], axis=0)
    return np.stack(
        [
            _affine(places[own], moved[own], places[i], overall)
            for i, own in enumerate([row[known[row]] for row in near])
        ]
    )


def _affine(
    places: Float[np.ndarray, "k 2"],
    moved: Float[np.ndarray, "k 2"],
    at: Float[np.ndarray, "2"],
    otherwise: Float[np.ndarray, "2"],
) -> Float[np.ndarray, "2"]:
    """Fit an affine displacement by reweighted least squares, and return it at a place."""
    if len(places) == 0:
        return otherwise
    if len(places) < 4:
        return np.median(moved, axis=0)
    offset = places - at
    scale = float(np.abs(offset).max())
    design = np.column_stack([np.ones(len(places)), offset / scale])
    weight = np.ones(len(places))
    # Slopes are held by a little, for neighbours that lie on a line tell only one.
    ridge = np.diag([0.0, 0.05, 0.05])
    for _ in range(4):
        normal = design.T @ (weight[:, None] * design) + ridge
        fit = np.linalg.solve(normal, design.T @ (weight[:, None] * moved))
        off = np.linalg.norm(moved - design @ fit, axis=1)
        spread = max(float(np.median(off)), 0.1)
        weight = 1.0 / (1.0 + (off / (2.0 * spread)) ** 2)
    return fit[0]

"""Detection of contacts in a sequence of frames, while it goes on.

Memory is bounded: of frames that cannot become presses only the time, the depth and the fault stay.
"""

import warnings
from bisect import insort
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.sensor.chain import Measurement, SensorChain
from tactorch.sensor.frames import Frame
from tactorch.sensor.markers import marker_displacements

_MAX_CANDIDATES = 256  # frames of a contact that are stored with displacements
_REST_FRAMES = 25  # without contact, from which the markers at rest are known


@dataclass(eq=False)
class ContactInterval:
    """Consecutive frames with contact.

    Displacements are stored for `max_candidates` frames at most. In longer contacts these are
    evenly spaced in depth; those up to the deepest frame, which may become presses, and those after
    it, which may if a deeper one follows, are thinned apart.

    Attributes:
        free_s: Time of the last frame without contact before; None if there is none.
        max_candidates: Largest number of frames with displacements, at least 6.
        rest_mm: Displacements of the markers from the reference image in the frames without
            contact before, (n, 2), mm; None without such frames or markers.
        measurements: Measurement of each frame, without images and height maps; that of a frame
            that is no candidate has no displacement and no markers.
    """

    free_s: float | None
    max_candidates: int = _MAX_CANDIDATES
    rest_mm: Float[np.ndarray, "n 2"] | None = None
    measurements: list[Measurement] = field(default_factory=list)
    _loading: list[tuple[float, int]] = field(default_factory=list)  # up to the deepest; sorted
    _later: list[tuple[float, int]] = field(default_factory=list)

    def append(self, measurement: Measurement) -> None:
        """Append the measurement of a frame, a candidate for a press."""
        entry = measurement.depth_mm, len(self.measurements)
        self.measurements.append(measurement)
        if not self._loading or entry[0] > self._loading[-1][0]:
            self._loading = sorted([*self._loading, *self._later, entry])
            self._later = []
            self._thin(self._loading)
        else:
            insort(self._later, entry)
            self._thin(self._later)

    def keep(self, indices: Iterable[int]) -> None:
        """Remove the displacements of all other frames."""
        kept = set(indices)
        for candidates in (self._loading, self._later):
            for k in reversed(range(len(candidates))):
                if candidates[k][1] not in kept:
                    self._reduce(candidates, k)

    def _thin(self, candidates: list[tuple[float, int]]) -> None:
        while len(candidates) > self.max_candidates // 2:
            depths = np.array([depth for depth, _ in candidates])
            # The removed frame leaves the smallest gap; the two at the ends stay.
            self._reduce(candidates, int(np.argmin(depths[2:] - depths[:-2])) + 1)

    def _reduce(self, candidates: list[tuple[float, int]], k: int) -> None:
        _, index = candidates.pop(k)
        self.measurements[index] = reduced(self.measurements[index])

    @property
    def times_s(self) -> Float[np.ndarray, " f"]:
        """Time of each frame."""
        return np.array([measurement.frame.time_s for measurement in self.measurements], float)

    @property
    def depths_mm(self) -> Float[np.ndarray, " f"]:
        """Depth of each frame."""
        return np.array([measurement.depth_mm for measurement in self.measurements])

    def select_frames(self, steps: int) -> list[int]:
        """Return up to `steps` candidates before the deepest, evenly spaced in depth."""
        candidates = np.array(sorted(index for _, index in self._loading))
        loading = self.depths_mm[candidates]
        targets = loading[-1] * np.arange(1, steps + 1) / steps
        nearest = np.abs(loading[None] - targets[:, None]).argmin(axis=1)
        return sorted({int(candidates[i]) for i in nearest})


def reduced(measurement: Measurement) -> Measurement:
    """Return a measurement with its frame, depth and slope only."""
    depth_mm, max_slope = measurement.depth_mm, measurement.max_slope
    no_markers, no_nodes = np.zeros((0, 2)), np.zeros(0, dtype=bool)
    return Measurement(measurement.frame, no_markers, no_nodes, None, depth_mm, max_slope)


class ContactDetector:
    """Detector of contacts of at least `min_frames`; `report` receives each frame's measurement.

    Frames that are not usable neither end a contact nor belong to one. Reported measurements have
    no images, heights, markers and displacements, which would fill the memory.
    """

    def __init__(
        self,
        chain: SensorChain,
        min_frames: int = 1,
        report: Callable[[Measurement], object] = lambda measurement: None,
    ) -> None:
        self.chain, self.min_frames, self.report = chain, min_frames, report
        self._squared_sum, self._count = 0.0, 0  # of marker displacements without contact, mm^2
        self._free: deque[Float[np.ndarray, "n 2"]] = deque(maxlen=_REST_FRAMES)

    def detect(self, frames: Iterable[Frame]) -> Iterator[ContactInterval]:
        """Yield each contact when it ends."""
        contact = ContactInterval(None)
        for frame in frames:
            stored = replace(frame, image=None)
            usable = frame.usable and frame.image is not None
            if usable and frame.time_s is None:
                raise ConfigError(
                    f"frame '{frame.name}' has no time, which is needed to find its pose: give"
                    " frame_rate_hz in the sensor's description."
                )
            measurement = self.chain.measure_deformation(frame if usable else stored)
            stored = replace(measurement.frame, image=None)
            measurement = replace(measurement, frame=stored, height=None)
            self.report(reduced(measurement))
            if measurement.displacement is not None:
                if not contact.measurements:
                    contact.rest_mm = self._rest()
                contact.append(measurement)
            elif usable:
                self._add_noise(measurement)
                if len(contact.measurements) >= self.min_frames:
                    yield contact
                contact = ContactInterval(frame.time_s)
        if len(contact.measurements) >= self.min_frames:
            yield contact

    @property
    def noise_mm(self) -> float | None:
        """Root mean square marker displacement in frames without contact; None if there is none."""
        return float(np.sqrt(self._squared_sum / self._count)) if self._count else None

    def _add_noise(self, measurement: Measurement) -> None:
        if self.chain.tracker is None:
            return
        sensor, reference_px = self.chain.sensor, self.chain.tracker.reference_px
        _, displacement = marker_displacements(sensor, reference_px, measurement.markers_px)
        self._free.append(displacement[:, :2])
        squares = displacement[:, :2] ** 2
        self._squared_sum += float(np.nansum(squares))
        self._count += int(np.isfinite(squares).sum())

    def _rest(self) -> Float[np.ndarray, "n 2"] | None:
        """Return the displacements of the markers in the last frames without contact, mm.

        They are those of a gel that drifts, and the errors of the markers in the reference image.
        The median leaves out frames shortly before a contact is detected. Markers that were not
        seen have zero.
        """
        if not self._free:
            return None
        with warnings.catch_warnings(action="ignore", category=RuntimeWarning):  # of unseen markers
            return np.nan_to_num(np.nanmedian(np.stack(self._free), axis=0))

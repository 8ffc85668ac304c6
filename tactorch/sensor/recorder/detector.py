"""Streaming detection of contacts in a sequence of frames."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from tactorch.errors import ConfigError
from tactorch.sensor.chain import Measurement, SensorChain
from tactorch.sensor.frames import Frame
from tactorch.sensor.markers import marker_displacements


@dataclass(eq=False)
class ContactInterval:
    """Consecutive frames with contact.

    Attributes:
        free_s: Time of the last frame without contact before; None if there is none.
        times_s: Time of each frame.
        depths_mm: Depth of each frame.
        measurements: Measurement of each frame, without images and height maps.
    """

    free_s: float | None
    times_s: list[float] = field(default_factory=list)
    depths_mm: list[float] = field(default_factory=list)
    measurements: list[Measurement] = field(default_factory=list)

    def add(self, measurement: Measurement, time_s: float, depth_mm: float) -> None:
        """Append a frame; its image and height map are dropped to save memory."""
        self.times_s.append(time_s)
        self.depths_mm.append(depth_mm)
        frame = replace(measurement.frame, image=None)
        self.measurements.append(replace(measurement, frame=frame, height=None))

    def select_frames(self, steps: int) -> list[int]:
        """Return up to `steps` frames before the deepest, evenly spaced in depth."""
        deepest = int(np.argmax(self.depths_mm))
        loading = np.array(self.depths_mm[: deepest + 1])
        targets = loading[-1] * np.arange(1, steps + 1) / steps
        nearest = np.abs(loading[None] - targets[:, None]).argmin(axis=1)
        return sorted({int(i) for i in nearest})


class FrameSummary(NamedTuple):
    """Summary of a frame.

    Attributes:
        frame: Position in the sequence.
        name: Name of the frame.
        time_s: Time since the first frame; None if unknown.
        depth_mm: Depth of the gel's face; NaN if not measured.
        max_slope: Largest slope of the face; NaN if not measured.
        fault: Description of the fault, or "".
    """

    frame: int
    name: str
    time_s: float | None
    depth_mm: float
    max_slope: float
    fault: str


@dataclass(eq=False)
class ContactDetector:
    """Detector of contacts that is fed frame by frame.

    Frames that are not usable neither end a contact nor belong to one.

    Attributes:
        chain: Calibrated sensor.
        min_frames: Shorter contacts are ignored.
        summary: Summary of the last frame; None before the first.
    """

    chain: SensorChain
    min_frames: int = 1
    summary: FrameSummary | None = None
    _current: ContactInterval | None = None
    _free_s: float | None = None
    _squared_sum: float = 0.0  # of marker displacements without contact, mm^2
    _count: int = 0

    def feed(self, frame: Frame) -> ContactInterval | None:
        """Process the next frame and return the contact that has ended with it, if any.

        Raises:
            ConfigError: The frame has no time, or another size than the reference.
        """
        depth_mm = max_slope = float("nan")
        ended = None
        if frame.image is not None and frame.usable:
            time_s, measurement = _require_time(frame), self.chain.measure_deformation(frame)
            if measurement.height is not None:
                depth_mm, max_slope = measurement.height.depth_mm, measurement.height.max_slope
            if measurement.displacement is None:
                self._add_noise(measurement)
                ended, self._free_s = self.finish(), time_s
            else:
                if self._current is None:
                    self._current = ContactInterval(self._free_s)
                self._current.add(measurement, time_s, depth_mm)
        self.summary = FrameSummary(
            frame.index, frame.name, frame.time_s, depth_mm, max_slope, frame.fault
        )
        return ended

    def finish(self) -> ContactInterval | None:
        """End the current contact and return it, if it has enough frames."""
        current, self._current = self._current, None
        if current is None or len(current.measurements) < self.min_frames:
            return None
        return current

    def detect(self, frames: Iterable[Frame]) -> Iterator[ContactInterval]:
        """Feed all frames and yield each contact when it ends."""
        for frame in frames:
            ended = self.feed(frame)
            if ended is not None:
                yield ended
        last = self.finish()
        if last is not None:
            yield last

    @property
    def noise_mm(self) -> float | None:
        """Root mean square marker displacement in frames without contact; None if there is none."""
        return float(np.sqrt(self._squared_sum / self._count)) if self._count else None

    def _add_noise(self, measurement: Measurement) -> None:
        reference_px = self.chain.tracker.reference_px
        _, displacement = marker_displacements(
            self.chain.sensor, reference_px, measurement.markers_px
        )
        squares = displacement[:, :2] ** 2
        self._squared_sum += float(np.nansum(squares))
        self._count += int(np.isfinite(squares).sum())


def _require_time(frame: Frame) -> float:
    if frame.time_s is None:
        raise ConfigError(
            f"frame '{frame.name}' has no time, which is needed to find its pose: give"
            " frame_rate_hz in the sensor's description."
        )
    return frame.time_s

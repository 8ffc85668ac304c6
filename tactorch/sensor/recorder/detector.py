"""Detection of contacts in a sequence of frames, while it goes on."""

from collections.abc import Callable, Iterable, Iterator
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

    def select_frames(self, steps: int) -> list[int]:
        """Return up to `steps` frames before the deepest, evenly spaced in depth."""
        loading = np.array(self.depths_mm[: int(np.argmax(self.depths_mm)) + 1])
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


class ContactDetector:
    """Detector of contacts of at least `min_frames`; `report` receives a summary of each frame.

    Frames that are not usable neither end a contact nor belong to one.
    """

    def __init__(
        self,
        chain: SensorChain,
        min_frames: int = 1,
        report: Callable[[FrameSummary], object] = lambda summary: None,
    ) -> None:
        self.chain, self.min_frames, self.report = chain, min_frames, report
        self._squared_sum, self._count = 0.0, 0  # of marker displacements without contact, mm^2

    def detect(self, frames: Iterable[Frame]) -> Iterator[ContactInterval]:
        """Yield each contact when it ends."""
        contact = ContactInterval(None)
        for frame in frames:
            depth = slope = float("nan")
            measurement = None
            if frame.image is not None and frame.usable:
                if frame.time_s is None:
                    raise ConfigError(
                        f"frame '{frame.name}' has no time, which is needed to find its pose: give"
                        " frame_rate_hz in the sensor's description."
                    )
                time_s, measurement = frame.time_s, self.chain.measure_deformation(frame)
                if measurement.height is not None:
                    depth, slope = measurement.height.depth_mm, measurement.height.max_slope
            summary = FrameSummary(frame.index, frame.name, frame.time_s, depth, slope, frame.fault)
            self.report(summary)
            if measurement is None:
                continue
            if measurement.displacement is not None:
                contact.times_s.append(time_s)
                contact.depths_mm.append(depth)
                stored = replace(frame, image=None)  # images and height maps fill the memory
                contact.measurements.append(replace(measurement, frame=stored, height=None))
                continue
            self._add_noise(measurement)
            if len(contact.measurements) >= self.min_frames:
                yield contact
            contact = ContactInterval(time_s)
        if len(contact.measurements) >= self.min_frames:
            yield contact

    @property
    def noise_mm(self) -> float | None:
        """Root mean square marker displacement in frames without contact; None if there is none."""
        return float(np.sqrt(self._squared_sum / self._count)) if self._count else None

    def _add_noise(self, measurement: Measurement) -> None:
        sensor, reference_px = self.chain.sensor, self.chain.tracker.reference_px
        _, displacement = marker_displacements(sensor, reference_px, measurement.markers_px)
        squares = displacement[:, :2] ** 2
        self._squared_sum += float(np.nansum(squares))
        self._count += int(np.isfinite(squares).sum())

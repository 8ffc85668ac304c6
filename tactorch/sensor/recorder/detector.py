"""Detection of contacts in a sequence of frames, while it goes on."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.sensor.chain import Measurement, SensorChain
from tactorch.sensor.frames import Frame
from tactorch.sensor.markers import marker_displacements


@dataclass(eq=False)
class ContactInterval:
    """Consecutive frames with contact.

    Attributes:
        free_s: Time of the last frame without contact before; None if there is none.
        measurements: Measurement of each frame, without images and height maps.
    """

    free_s: float | None
    measurements: list[Measurement] = field(default_factory=list)

    @property
    def times_s(self) -> Float[np.ndarray, " f"]:
        """Time of each frame."""
        return np.array([measurement.frame.time_s for measurement in self.measurements], float)

    @property
    def depths_mm(self) -> Float[np.ndarray, " f"]:
        """Depth of each frame."""
        return np.array([measurement.depth_mm for measurement in self.measurements])

    def select_frames(self, steps: int) -> list[int]:
        """Return up to `steps` frames before the deepest, evenly spaced in depth."""
        loading = self.depths_mm[: int(np.argmax(self.depths_mm)) + 1]
        targets = loading[-1] * np.arange(1, steps + 1) / steps
        nearest = np.abs(loading[None] - targets[:, None]).argmin(axis=1)
        return sorted({int(i) for i in nearest})


class ContactDetector:
    """Detector of contacts of at least `min_frames`; `report` receives each frame's measurement.

    Frames that are not usable neither end a contact nor belong to one. Measurements are reported
    and stored without images and height maps, which would fill the memory.
    """

    def __init__(
        self,
        chain: SensorChain,
        min_frames: int = 1,
        report: Callable[[Measurement], object] = lambda measurement: None,
    ) -> None:
        self.chain, self.min_frames, self.report = chain, min_frames, report
        self._squared_sum, self._count = 0.0, 0  # of marker displacements without contact, mm^2

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
            measurement = replace(measurement, frame=stored, height=None)
            self.report(measurement)
            if measurement.displacement is not None:
                contact.measurements.append(measurement)
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
        squares = displacement[:, :2] ** 2
        self._squared_sum += float(np.nansum(squares))
        self._count += int(np.isfinite(squares).sum())

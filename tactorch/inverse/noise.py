"""How far each datum is believed: the standard deviation of every observed displacement."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import ndtri

from tactorch.errors import ConfigError
from tactorch.recording import Press, Recording

_MEDIAN = float(ndtri(0.75))  # median size of a standard normal number


@dataclass(frozen=True)
class NoiseModel:
    """Standard deviations of the observed displacements.

    In this order: `mm`, where given; what the press states; what the recording's unloaded frames
    show; `relative`.

    Attributes:
        relative: Noise as a fraction of the root mean square of all observed displacements; also
            a floor for stated and estimated noise, since no model is exact.
        mm: Noise in mm, overriding what the recording says.
    """

    relative: float = 1e-4
    mm: float | None = None

    def __post_init__(self) -> None:
        """Check ranges."""
        if not 0 < self.relative < 1:
            raise ConfigError(
                f"noise.relative={self.relative}: give a fraction of the signal in (0, 1)."
            )
        if self.mm is not None and not self.mm > 0:
            raise ConfigError(f"noise.mm={self.mm}: give a standard deviation above 0 mm, or null.")

    def deviations(self, recording: Recording) -> list[float]:
        """Return the standard deviation of each press's displacements, mm."""
        floor = self.relative * signal_rms(recording.presses)
        return [max(known, floor) for known in self._known(recording, floor)]

    def assumed(self, recording: Recording) -> bool:
        """Say whether the noise of some press is assumed, for want of a statement."""
        known = self.mm is not None or recording.unloaded is not None
        return not known and any(press.noise_mm is None for press in recording.presses)

    def floored(self, recording: Recording) -> bool:
        """Say whether the noise of some press may be less than what it is taken to be."""
        floor = self.relative * signal_rms(recording.presses)
        return any(known <= floor for known in self._known(recording, floor))

    def _known(self, recording: Recording, floor: float) -> list[float]:
        """Each press's deviation before the floor, mm."""
        if self.mm is not None:
            return [self.mm] * len(recording.presses)
        default = floor if recording.unloaded is None else unloaded_noise(recording.unloaded)
        return [default if p.noise_mm is None else p.noise_mm for p in recording.presses]


def unloaded_noise(frames: Float[np.ndarray, "frames n 3"]) -> float:
    """Estimate the standard deviation (mm) of each displacement from frames without contact.

    From the median change between frames in turn: neither a slow drift nor a few stray markers
    count.
    """
    changes = np.abs(np.diff(frames, axis=0))
    return float(np.nanmedian(changes)) / (_MEDIAN * np.sqrt(2.0))


def signal_rms(presses: tuple[Press, ...]) -> float:
    """Root mean square of all observed displacements, mm.

    Raises:
        ConfigError: all observed displacements are zero.
    """
    values = np.concatenate([press.displacement[press.data] for press in presses])
    rms = float(np.sqrt(np.mean(values**2)))
    if rms == 0.0:
        raise ConfigError("all observed displacements are zero: the presses moved nothing.")
    return rms

"""Noise: the standard deviation of every observed displacement."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float
from scipy.special import ndtri

from tactorch.config import Options, option
from tactorch.errors import ConfigError
from tactorch.recording import Press, Recording

_MEDIAN = float(ndtri(0.75))  # median size of a standard normal number


@dataclass(frozen=True)
class NoiseModel(Options):
    """Standard deviations of the observed displacements.

    The first that applies: `mm`, where given; the value stated by the press; the estimate from the
    recording's unloaded frames; `relative`.

    Attributes:
        relative: Noise as a fraction of the root mean square of all observed displacements; also
            a floor for stated and estimated noise, since no model is exact.
        mm: Noise in mm, which overrides the recording's.
    """

    section: ClassVar[str] = "noise"
    relative: float = option(
        1e-4, "Noise as a fraction of the signal where it is not stated; a floor elsewhere",
        gt=0, lt=1,
    )  # fmt: skip
    mm: float | None = option(
        None, "Noise, which overrides what the recording states", unit="mm", gt=0
    )

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

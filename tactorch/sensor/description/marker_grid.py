"""Markers on a gel. Lengths in mm."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.mesh.values import Real, positive
from tactorch.sensor.description.numbers import lengths, numbers

_MOST = 1000  # markers in a row


@dataclass(frozen=True)
class MarkerGrid:
    """Markers in rows and columns, the middle of the grid in the middle of the gel.

    Attributes:
        columns: Along x.
        rows: Along y.
        pitch_mm: Distance between columns, and between rows.
        diameter_mm: Of a marker.
        within_mm: Radius about the middle beyond which there are none; None for a whole grid.
        shift_mm: Of the grid's middle from the gel's.

    Raises:
        ConfigError: A value cannot be used; the message names it.
    """

    columns: int
    rows: int
    pitch_mm: Sequence[Real]
    diameter_mm: Real
    within_mm: Real | None = None
    shift_mm: Sequence[Real] = (0.0, 0.0)

    def __post_init__(self) -> None:
        for name in ("columns", "rows"):
            count = getattr(self, name)
            if not isinstance(count, int | np.integer) or not 1 <= count <= _MOST:
                raise ConfigError(f"{name}={count!r} must be a whole number from 1 to {_MOST}.")
        object.__setattr__(self, "pitch_mm", lengths("pitch_mm", self.pitch_mm, 2))
        object.__setattr__(self, "shift_mm", numbers("shift_mm", self.shift_mm, 2))
        if positive("diameter_mm", self.diameter_mm) >= min(map(float, self.pitch_mm)):
            raise ConfigError(
                f"diameter_mm={self.diameter_mm:g} is no less than the pitch"
                f" {min(map(float, self.pitch_mm)):g} mm: markers would touch."
            )
        if self.within_mm is not None:
            positive("within_mm", self.within_mm)
        if not len(self.places_mm):
            raise ConfigError(f"within_mm={self.within_mm} leaves no marker.")

    @property
    def places_mm(self) -> Float[np.ndarray, "n 2"]:
        """Their centres at rest, row by row."""
        x, y = (
            (np.arange(count) - (count - 1) / 2) * float(pitch)
            for count, pitch in zip((self.columns, self.rows), self.pitch_mm, strict=True)
        )
        places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        if self.within_mm is not None:
            places = places[np.linalg.norm(places, axis=1) <= float(self.within_mm)]
        return places + np.asarray(self.shift_mm, dtype=float)

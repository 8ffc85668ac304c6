"""Light on a gel: its matt face, seen from within the sensor, under coloured lamps."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.mesh.values import Real, positive

#: Red from the right, green from below left, blue from above left, as seen in the image.
_COLOURS = ((190.0, 25.0, 20.0), (25.0, 170.0, 30.0), (20.0, 35.0, 185.0))


@dataclass(frozen=True)
class Lamps:
    """Lamps around the gel, far enough that their light is parallel.

    Attributes:
        azimuths_deg: Where each stands, from x (right) toward y (down).
        elevation_deg: Of all above the face.
        colours: Red, green and blue of each lamp on a face square to it, grey values.
        ambient: Of the light that comes from everywhere.
        falloff: Share of a lamp's light that is lost from its side to the other.
        shadow: Share of a lamp's light that a shadow takes.

    Raises:
        ConfigError: A value cannot be used.
    """

    azimuths_deg: Sequence[Real] = (0.0, 120.0, 240.0)
    elevation_deg: Real = 35.0
    colours: Sequence[Sequence[Real]] = _COLOURS
    ambient: Sequence[Real] = (45.0, 45.0, 45.0)
    falloff: Real = 0.25
    shadow: Real = 0.6

    def __post_init__(self) -> None:
        if len(self.azimuths_deg) != len(self.colours) or not len(self.colours):
            raise ConfigError(
                f"{len(self.azimuths_deg)} azimuths_deg, {len(self.colours)} colours: give one"
                " colour for each lamp."
            )
        if not 0 < float(self.elevation_deg) < 90:
            raise ConfigError(f"elevation_deg={self.elevation_deg:g} must lie between 0 and 90.")
        for name in ("falloff", "shadow"):
            if not 0 <= float(getattr(self, name)) <= 1:
                raise ConfigError(f"{name}={getattr(self, name):g}: give a share, from 0 to 1.")

    def on(
        self, height_mm: Float[np.ndarray, "h w"], mm_per_px: tuple[float, float]
    ) -> Float[np.ndarray, "h w 3"]:
        """Return the light of a face, z toward the object, in grey values."""
        x, y = (positive("mm_per_px", size) for size in mm_per_px)
        along, across = np.gradient(height_mm, y, x)
        # The face is seen from below: its normal points into the sensor.
        normal = np.stack([across, along, -np.ones_like(across)], axis=-1)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        light = np.broadcast_to(np.asarray(self.ambient, float), (*height_mm.shape, 3)).copy()
        for azimuth, colour in zip(self.azimuths_deg, self.colours, strict=True):
            way = self._toward(float(azimuth))
            share = np.maximum(normal @ way, 0.0) * self._reaching(height_mm.shape, way)
            share *= 1.0 - float(self.shadow) * _shadowed(height_mm, way, (x, y))
            light += share[..., None] * np.asarray(colour, float)
        return light

    def _toward(self, azimuth_deg: float) -> Float[np.ndarray, "3"]:
        a, e = np.deg2rad(azimuth_deg), np.deg2rad(float(self.elevation_deg))
        return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), -np.sin(e)])

    def _reaching(self, shape: tuple[int, ...], way: Float[np.ndarray, "3"]) -> np.ndarray:
        rows, columns = np.mgrid[-1 : 1 : shape[0] * 1j, -1 : 1 : shape[1] * 1j]
        flat = np.hypot(way[0], way[1])
        near = (columns * way[0] + rows * way[1]) / flat
        return 1.0 - float(self.falloff) * (1.0 - near) / 2.0


def _shadowed(
    height_mm: Float[np.ndarray, "h w"], way: Float[np.ndarray, "3"], size: tuple[float, float]
) -> Float[np.ndarray, "h w"]:
    """Share of each pixel that a bump of the face between it and the lamp shades, softly."""
    import cv2

    bump = -height_mm.astype(np.float32)  # into the sensor
    flat = float(np.hypot(way[0], way[1]))
    rise = -way[2] / flat  # of the light for each mm toward the lamp
    reach = float(np.ptp(bump)) / rise
    step = 2.0 * max(size)
    shade = np.zeros(bump.shape, np.float32)
    rows, columns = np.indices(bump.shape, dtype=np.float32)
    for k in range(1, min(60, int(reach / step)) + 1):
        off = k * step
        x = (columns + off * way[0] / flat / size[0]).astype(np.float32)
        y = (rows + off * way[1] / flat / size[1]).astype(np.float32)
        there = cv2.remap(bump, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        over = there - bump - rise * off
        shade = np.maximum(shade, np.clip(over / 0.05, 0.0, 1.0))
    return shade.astype(np.float64)

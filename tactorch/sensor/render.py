"""Rendering of a simulated sensor: images of a deformed gel under colored lamps.

The images are those of the differentiable camera, `tactorch.sensor.camera`, with noise.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from jaxtyping import Float
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

from tactorch.config import Options, option
from tactorch.errors import ConfigError
from tactorch.sensor.description import SensorDescription
from tactorch.sensor.frames import Image

if TYPE_CHECKING:
    from tactorch.sensor.camera import GelCamera, Shading

#: Red from the right, green from below left, blue from above left, as seen in the image.
_COLOURS = ((190.0, 25.0, 20.0), (25.0, 170.0, 30.0), (20.0, 35.0, 185.0))
_Colour = tuple[float, float, float]
_Vectors = Float[np.ndarray, "k 3"]


@dataclass(frozen=True)
class Lamps(Options):
    """Distant lamps around the gel, with parallel light."""

    azimuths_deg: tuple[float, ...] = option(
        (0.0, 120.0, 240.0), "Direction of each lamp, from x (right) toward y (down)", unit="deg"
    )
    elevation_deg: float = option(
        35.0, "Elevation of all lamps above the face", unit="deg", gt=0, lt=90
    )
    colours: tuple[_Colour, ...] = option(
        _COLOURS, "Red, green and blue of each lamp on a face normal to it, gray values"
    )
    ambient: _Colour = option((45.0, 45.0, 45.0), "Red, green and blue of the ambient light")
    falloff: float = option(
        0.25, "Fraction of a lamp's light that is lost across the image", ge=0, le=1
    )
    shadow: float = option(0.6, "Fraction of a lamp's light that a shadow removes", ge=0, le=1)

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.azimuths_deg) != len(self.colours) or not self.colours:
            raise ConfigError(
                f"{len(self.azimuths_deg)} azimuths_deg, {len(self.colours)} colours: give one"
                " colour for each lamp."
            )

    def shading(self) -> "Shading":
        """Return the light of the lamps for the differentiable camera."""
        from tactorch.sensor.camera import Shading

        return Shading(
            self.azimuths_deg, self.elevation_deg, self.colours, self.ambient, self.falloff
        )


def _batch(values: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(values, dtype=np.float64))[None]


@dataclass(frozen=True)
class RenderOptions(Options):
    """Appearance of a simulated sensor."""

    lamps: Lamps = option(factory=Lamps, help="Lamps")
    noise: float = option(1.5, "Standard deviation of the camera noise, gray values", ge=0)
    marker_darkness: float = option(0.8, "Fraction of the light absorbed by a marker", ge=0, le=1)

    def camera(self, sensor: SensorDescription) -> "GelCamera":
        """Return the differentiable camera of a sensor, in float64."""
        from tactorch.sensor.camera import GelCamera

        return GelCamera(
            self.lamps.shading(),
            sensor.mm_per_px,
            shadow=self.lamps.shadow,
            marker_diameter_mm=0.0 if sensor.markers is None else sensor.markers.diameter_mm,
            marker_darkness=self.marker_darkness,
        )


@dataclass(frozen=True, eq=False)
class GelSurface:
    """Deformed outer face of the gel in image coordinates.

    Attributes:
        height_mm: z of the face at each pixel, relative to rest.
        markers_px: Markers (column, row).
    """

    height_mm: Float[np.ndarray, "h w"]
    markers_px: Float[np.ndarray, "n 2"]


def build_surface(
    sensor: SensorDescription, points: _Vectors, displacement: _Vectors
) -> GelSurface:
    """Return the surface for displacements (mm) of the gel's nodes; it is at rest outside of them.

    `points` are the nodes of the gel's outer face at rest, mm, as `GelModel.points`.
    """
    deformed = points + displacement
    pixels = pixel_positions(sensor)
    # The image shows a point at its current position.
    height = LinearNDInterpolator(deformed[:, :2], deformed[:, 2], fill_value=np.nan)(pixels)
    rise = np.where(np.isfinite(height), height - sensor.gel.height_mm(pixels), 0.0)
    markers = marker_positions(sensor, points, displacement, LinearNDInterpolator)
    return GelSurface(rise.reshape(sensor.shape), sensor.to_px(markers))


def marker_positions(
    sensor: SensorDescription,
    points: _Vectors,
    displacement: _Vectors,
    interpolator: Callable[..., Any],
) -> Float[np.ndarray, "n 2"]:
    """Return the markers (mm) for displacements of the gel's nodes, beyond them of the nearest."""
    if sensor.markers is None:
        return np.zeros((0, 2))
    at, moved = sensor.markers.positions_mm, displacement[:, :2]
    inside = interpolator(points[:, :2], moved)(at)
    nearest = NearestNDInterpolator(points[:, :2], moved)(at)
    return at + np.where(np.isfinite(inside), inside, nearest)


def pixel_positions(sensor: SensorDescription) -> Float[np.ndarray, "p 2"]:
    """Return x and y of each pixel, row by row, mm."""
    rows, columns = np.indices(sensor.shape)
    return sensor.to_mm(np.stack([columns, rows], axis=-1).reshape(-1, 2).astype(float))


def render(
    sensor: SensorDescription,
    surface: GelSurface,
    options: RenderOptions | None = None,
    seed: int | None = None,
) -> Image:
    """Return the rendered image of a surface; without a seed of the camera noise, free of noise."""
    options = options or RenderOptions()
    if surface.height_mm.shape != sensor.shape:
        raise ConfigError(f"heights are {surface.height_mm.shape}, images {sensor.shape}.")
    if not np.isfinite(surface.height_mm).all():
        raise ConfigError("heights are not finite everywhere; give 0 where the face is at rest.")
    rest = sensor.gel.height_mm(pixel_positions(sensor)).reshape(sensor.shape)
    markers = None if sensor.markers is None else _batch(surface.markers_px)
    with torch.no_grad():
        images = options.camera(sensor)(_batch(rest + surface.height_mm), markers)
    light = np.ascontiguousarray(images[0].movedim(0, -1).numpy())
    if seed is not None and options.noise > 0:
        light += np.random.default_rng(seed).normal(0.0, options.noise, light.shape)
    return np.clip(light.round(), 0, 255).astype(np.uint8)

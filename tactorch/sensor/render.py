"""Rendering of a simulated sensor: images of a deformed gel under colored lamps."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

from tactorch.config import Options, option
from tactorch.errors import ConfigError
from tactorch.mesh.values import positive
from tactorch.sensor.description import SensorDescription
from tactorch.sensor.frames import Image

_EDGE_PX = 0.5  # blur of a marker's edge
_PENUMBRA_MM = 0.05
_MAX_SHADOW_STEPS = 60
#: Red from the right, green from below left, blue from above left, as seen in the image.
_COLOURS = ((190.0, 25.0, 20.0), (25.0, 170.0, 30.0), (20.0, 35.0, 185.0))
_Colour = tuple[float, float, float]


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

    def illuminate(
        self, height_mm: Float[np.ndarray, "h w"], mm_per_px: tuple[float, float]
    ) -> Float[np.ndarray, "h w 3"]:
        """Return the light from a matt face by its height, z toward the object; gray values."""
        x, y = (positive("mm_per_px", size) for size in mm_per_px)
        slope_y, slope_x = np.gradient(height_mm, y, x)
        # The camera is inside the sensor: the visible normal points along -z.
        normal = np.stack([slope_x, slope_y, -np.ones_like(slope_x)], axis=-1)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        light = np.broadcast_to(self.ambient, (*height_mm.shape, 3)).copy()
        elevation = np.deg2rad(self.elevation_deg)
        rows, columns = (np.linspace(-1, 1, n) for n in height_mm.shape)
        for azimuth, colour in zip(np.deg2rad(self.azimuths_deg), self.colours, strict=True):
            toward = np.array([np.cos(azimuth), np.sin(azimuth)])
            direction = np.array([*np.cos(elevation) * toward, -np.sin(elevation)])
            proximity = columns * toward[0] + rows[:, None] * toward[1]
            intensity = np.maximum(normal @ direction, 0.0)
            intensity *= 1.0 - self.falloff * (1.0 - proximity) / 2.0
            intensity *= 1.0 - self.shadow * _shadow(height_mm, direction, (x, y))
            light += intensity[..., None] * np.array(colour)
        return light


def _shadow(height_mm: np.ndarray, direction: np.ndarray, size: tuple[float, float]) -> np.ndarray:
    """Fraction of each pixel in the shadow of the face between it and the lamp."""
    relief = -height_mm.astype(np.float32)  # into the sensor
    in_plane = float(np.hypot(direction[0], direction[1]))
    rise = -direction[2] / in_plane  # of a ray per mm toward the lamp
    reach = float(np.ptp(relief)) / rise
    step = 2.0 * max(size)
    shadow = np.zeros(relief.shape, np.float32)
    rows, columns = np.indices(relief.shape, dtype=np.float32)
    for k in range(1, min(_MAX_SHADOW_STEPS, int(reach / step)) + 1):
        offset = k * step
        x = (columns + offset * direction[0] / in_plane / size[0]).astype(np.float32)
        y = (rows + offset * direction[1] / in_plane / size[1]).astype(np.float32)
        occluder = cv2.remap(relief, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        excess = occluder - relief - rise * offset
        shadow = np.maximum(shadow, np.clip(excess / _PENUMBRA_MM, 0.0, 1.0))
    return shadow.astype(np.float64)


@dataclass(frozen=True)
class RenderOptions(Options):
    """Appearance of a simulated sensor."""

    lamps: Lamps = option(factory=Lamps, help="Lamps")
    noise: float = option(1.5, "Standard deviation of the camera noise, gray values", ge=0)
    marker_darkness: float = option(0.8, "Fraction of the light absorbed by a marker", ge=0, le=1)


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
    sensor: SensorDescription,
    points: Float[np.ndarray, "k 3"],
    displacement: Float[np.ndarray, "k 3"],
) -> GelSurface:
    """Return the surface for displacements (mm) of the gel's nodes; it is at rest outside of them.

    `points` are the nodes of the gel's outer face at rest, mm, as `GelModel.points`.
    """
    deformed = points + displacement
    pixels = _pixel_positions(sensor)
    # The image shows a point at its current position.
    height = LinearNDInterpolator(deformed[:, :2], deformed[:, 2], fill_value=np.nan)(pixels)
    rise = np.where(np.isfinite(height), height - sensor.gel.height_mm(pixels), 0.0)
    markers = np.zeros((0, 2))
    if sensor.markers is not None:
        markers = sensor.markers.positions_mm
        inside = LinearNDInterpolator(points[:, :2], displacement[:, :2])(markers)
        nearest = NearestNDInterpolator(points[:, :2], displacement[:, :2])(markers)
        markers = markers + np.where(np.isfinite(inside), inside, nearest)
    return GelSurface(rise.reshape(sensor.shape), sensor.to_px(markers))


def _pixel_positions(sensor: SensorDescription) -> Float[np.ndarray, "p 2"]:
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
    rest = sensor.gel.height_mm(_pixel_positions(sensor)).reshape(sensor.shape)
    light = options.lamps.illuminate(rest + surface.height_mm, sensor.mm_per_px)
    light *= (1.0 - options.marker_darkness * _coverage(sensor, surface.markers_px))[..., None]
    if seed is not None and options.noise > 0:
        light += np.random.default_rng(seed).normal(0.0, options.noise, light.shape)
    return np.clip(light.round(), 0, 255).astype(np.uint8)


def _coverage(sensor: SensorDescription, markers_px: np.ndarray) -> Float[np.ndarray, "h w"]:
    """Fraction of each pixel covered by a marker, with blurred edges."""
    coverage = np.zeros(sensor.shape)
    if sensor.markers is None:
        return coverage
    radius = sensor.markers.diameter_mm / 2 / np.array(sensor.mm_per_px)
    margin = np.ceil(radius + 4 * _EDGE_PX).astype(int)
    size = np.array(sensor.image_size_px)
    for center in markers_px:
        (left, top), (right, bottom) = (
            np.clip(center.round().astype(int) + s * margin, 0, size) for s in (-1, 1)
        )
        y, x = np.mgrid[top : min(bottom + 1, size[1]), left : min(right + 1, size[0])]
        distance = np.hypot((x - center[0]) / radius[0], (y - center[1]) / radius[1])
        exponent = np.clip((distance - 1) * radius.mean() / _EDGE_PX * 2, -40, 40)
        window = coverage[top : bottom + 1, left : right + 1]
        np.maximum(window, 1.0 / (1.0 + np.exp(exponent)), out=window)
    return coverage

"""Rendering of a simulated sensor: images of a deformed gel under colored lamps."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

from tactorch.errors import ConfigError
from tactorch.mesh.values import Real, positive
from tactorch.sensor.description import SensorDescription
from tactorch.sensor.frames import Image

_EDGE_PX = 0.5  # blur of a marker's edge
_PENUMBRA_MM = 0.05
_MAX_SHADOW_STEPS = 60
#: Red from the right, green from below left, blue from above left, as seen in the image.
_COLOURS = ((190.0, 25.0, 20.0), (25.0, 170.0, 30.0), (20.0, 35.0, 185.0))


@dataclass(frozen=True)
class Lamps:
    """Distant lamps around the gel, with parallel light.

    Attributes:
        azimuths_deg: Direction of each lamp, from x (right) toward y (down).
        elevation_deg: Elevation of all lamps above the face.
        colours: Red, green and blue of each lamp on a face normal to it, gray values.
        ambient: Red, green and blue of the ambient light.
        falloff: Fraction of a lamp's light that is lost across the image.
        shadow: Fraction of a lamp's light that a shadow removes.

    Raises:
        ConfigError: A value is out of range.
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
            raise ConfigError(f"elevation_deg={self.elevation_deg:g} must be between 0 and 90.")
        for name in ("falloff", "shadow"):
            if not 0 <= float(getattr(self, name)) <= 1:
                raise ConfigError(f"{name}={getattr(self, name):g}: give a fraction, from 0 to 1.")

    def illuminate(
        self, height_mm: Float[np.ndarray, "h w"], mm_per_px: tuple[float, float]
    ) -> Float[np.ndarray, "h w 3"]:
        """Return the light from a matt face, gray values.

        Args:
            height_mm: Height of the face, z toward the object.
            mm_per_px: Size of a pixel along x and y, mm.
        """
        x, y = (positive("mm_per_px", size) for size in mm_per_px)
        slope_y, slope_x = np.gradient(height_mm, y, x)
        # The camera is inside the sensor: the visible normal points along -z.
        normal = np.stack([slope_x, slope_y, -np.ones_like(slope_x)], axis=-1)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        light = np.broadcast_to(np.asarray(self.ambient, float), (*height_mm.shape, 3)).copy()
        for azimuth, colour in zip(self.azimuths_deg, self.colours, strict=True):
            direction = self._direction(float(azimuth))
            intensity = np.maximum(normal @ direction, 0.0)
            intensity = intensity * self._attenuation(height_mm.shape, direction)
            intensity *= 1.0 - float(self.shadow) * _shadow(height_mm, direction, (x, y))
            light += intensity[..., None] * np.asarray(colour, float)
        return light

    def _direction(self, azimuth_deg: float) -> Float[np.ndarray, "3"]:
        a, e = np.deg2rad(azimuth_deg), np.deg2rad(float(self.elevation_deg))
        return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), -np.sin(e)])

    def _attenuation(self, shape: tuple[int, ...], direction: Float[np.ndarray, "3"]) -> np.ndarray:
        rows, columns = np.mgrid[-1 : 1 : shape[0] * 1j, -1 : 1 : shape[1] * 1j]
        in_plane = np.hypot(direction[0], direction[1])
        proximity = (columns * direction[0] + rows * direction[1]) / in_plane
        return 1.0 - float(self.falloff) * (1.0 - proximity) / 2.0


def _shadow(
    height_mm: Float[np.ndarray, "h w"],
    direction: Float[np.ndarray, "3"],
    size: tuple[float, float],
) -> Float[np.ndarray, "h w"]:
    """Fraction of each pixel in the shadow of the face between it and the lamp."""
    import cv2

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
class RenderOptions:
    """Appearance of a simulated sensor.

    Attributes:
        lamps: Lamps.
        noise: Standard deviation of the camera noise, gray values.
        marker_darkness: Fraction of the light that a marker absorbs.
    """

    lamps: Lamps = field(default_factory=Lamps)
    noise: float = 1.5
    marker_darkness: float = 0.8

    def __post_init__(self) -> None:
        if self.noise < 0 or not 0 <= self.marker_darkness <= 1:
            raise ConfigError(
                f"noise={self.noise:g} must not be negative, marker_darkness="
                f"{self.marker_darkness:g} a fraction."
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
    sensor: SensorDescription,
    points: Float[np.ndarray, "k 3"],
    displacement: Float[np.ndarray, "k 3"],
) -> GelSurface:
    """Return the surface for displacements of the gel's nodes.

    Args:
        sensor: Sensor description.
        points: Nodes of the gel's outer face at rest, mm, as `GelModel.points`.
        displacement: Displacements of the nodes, mm.

    Returns:
        The surface; it is at rest outside the nodes.
    """
    deformed = points + displacement
    pixels = _pixel_positions(sensor)
    # The image shows a point at its current position.
    height = LinearNDInterpolator(deformed[:, :2], deformed[:, 2], fill_value=np.nan)(pixels)
    rise = np.where(np.isfinite(height), height - sensor.gel.height_mm(pixels), 0.0)
    markers = np.zeros((0, 2)) if sensor.markers is None else sensor.markers.positions_mm
    moved = markers + _in_plane_displacement(points, displacement, markers)
    return GelSurface(rise.reshape(sensor.shape), sensor.to_px(moved))


def _pixel_positions(sensor: SensorDescription) -> Float[np.ndarray, "p 2"]:
    rows, columns = np.indices(sensor.shape)
    return sensor.to_mm(np.stack([columns, rows], axis=-1).reshape(-1, 2).astype(float))


def _in_plane_displacement(
    points: Float[np.ndarray, "k 3"],
    displacement: Float[np.ndarray, "k 3"],
    positions: Float[np.ndarray, "n 2"],
) -> Float[np.ndarray, "n 2"]:
    if not len(positions):
        return np.zeros((0, 2))
    inside = LinearNDInterpolator(points[:, :2], displacement[:, :2])(positions)
    nearest = NearestNDInterpolator(points[:, :2], displacement[:, :2])(positions)
    return np.where(np.isfinite(inside), inside, nearest)


def render(
    sensor: SensorDescription,
    surface: GelSurface,
    options: RenderOptions | None = None,
    seed: int | None = None,
) -> Image:
    """Render the image of a surface.

    Args:
        sensor: Sensor description.
        surface: Deformed face of the gel.
        options: Appearance.
        seed: Seed of the camera noise; None for no noise.

    Returns:
        The image.

    Raises:
        ConfigError: The surface has another size than the image, or is not finite.
    """
    options = options or RenderOptions()
    if surface.height_mm.shape != sensor.shape:
        raise ConfigError(f"heights are {surface.height_mm.shape}, images {sensor.shape}.")
    if not np.isfinite(surface.height_mm).all():
        raise ConfigError("heights are not finite everywhere; give 0 where the face is at rest.")
    rest = sensor.gel.height_mm(_pixel_positions(sensor)).reshape(sensor.shape)
    x, y = sensor.mm_per_px
    light = options.lamps.illuminate(rest + surface.height_mm, (float(x), float(y)))
    light *= (1.0 - options.marker_darkness * _coverage(sensor, surface.markers_px))[..., None]
    if seed is not None and options.noise > 0:
        light += np.random.default_rng(seed).normal(0.0, options.noise, light.shape)
    return np.clip(light.round(), 0, 255).astype(np.uint8)


def _coverage(
    sensor: SensorDescription, markers_px: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "h w"]:
    """Fraction of each pixel covered by a marker, with blurred edges."""
    coverage = np.zeros(sensor.shape)
    if sensor.markers is None:
        return coverage
    radius = np.array([float(sensor.markers.diameter_mm) / 2 / float(s) for s in sensor.mm_per_px])
    margin = np.ceil(radius + 4 * _EDGE_PX).astype(int)
    height, width = sensor.shape
    for column, row in markers_px:
        left, right = (int(np.clip(round(column) + s * margin[0], 0, width)) for s in (-1, 1))
        top, bottom = (int(np.clip(round(row) + s * margin[1], 0, height)) for s in (-1, 1))
        y, x = np.mgrid[top : bottom + 1, left : right + 1]
        distance = np.hypot((x - column) / radius[0], (y - row) / radius[1])
        exponent = np.clip((distance - 1) * radius.mean() / _EDGE_PX * 2, -40, 40)
        inside = 1.0 / (1.0 + np.exp(exponent))
        window = coverage[top : bottom + 1, left : right + 1]
        np.maximum(window, inside[: window.shape[0], : window.shape[1]], out=window)
    return coverage

"""A simulated sensor: from how the gel's face moved to the image that its camera takes."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

from tactorch.errors import ConfigError
from tactorch.sensor.description import SensorDescription
from tactorch.sensor.frames import Image
from tactorch.sensor.render.light import Lamps

_SOFT_PX = 0.5  # of a marker's edge


@dataclass(frozen=True)
class Look:
    """How a simulated sensor looks.

    Attributes:
        lamps: The light.
        noise: Standard deviation of the camera's noise, grey values.
        marker_darkness: Share of the light that a marker takes.
    """

    lamps: Lamps = field(default_factory=Lamps)
    noise: float = 1.5
    marker_darkness: float = 0.8

    def __post_init__(self) -> None:
        if self.noise < 0 or not 0 <= self.marker_darkness <= 1:
            raise ConfigError(
                f"noise={self.noise:g} must not be negative, marker_darkness="
                f"{self.marker_darkness:g} a share."
            )


@dataclass(frozen=True, eq=False)
class Face:
    """The gel's face as the camera sees it.

    Attributes:
        height_mm: z of the face at each pixel, less that at rest.
        markers_px: Where the markers are (column, row).
    """

    height_mm: Float[np.ndarray, "h w"]
    markers_px: Float[np.ndarray, "n 2"]


def face_of(
    sensor: SensorDescription,
    points: Float[np.ndarray, "k 3"],
    displacement: Float[np.ndarray, "k 3"],
) -> Face:
    """Return the face that nodes on it make.

    Args:
        sensor: The sensor.
        points: Nodes of the gel's outer face at rest, mm, as `GelModel.points`.
        displacement: Of them, mm.
    """
    now = points + displacement
    rows, columns = np.indices(sensor.shape)
    places = sensor.to_mm(np.stack([columns, rows], axis=-1).reshape(-1, 2).astype(float))
    # The camera sees a point where it is now; beyond the nodes the face is at rest.
    risen = LinearNDInterpolator(now[:, :2], now[:, 2], fill_value=np.nan)(places)
    rest = sensor.gel.height_mm(places)
    height = np.where(np.isfinite(risen), risen - rest, 0.0).reshape(sensor.shape)
    markers = np.zeros((0, 2)) if sensor.markers is None else sensor.markers.positions_mm
    return Face(height, sensor.to_px(markers + _at(points, displacement, markers)))


def _at(
    points: Float[np.ndarray, "k 3"],
    displacement: Float[np.ndarray, "k 3"],
    places: Float[np.ndarray, "n 2"],
) -> Float[np.ndarray, "n 2"]:
    """In-plane displacement at places of the face."""
    if not len(places):
        return np.zeros((0, 2))
    inner = LinearNDInterpolator(points[:, :2], displacement[:, :2])(places)
    edge = NearestNDInterpolator(points[:, :2], displacement[:, :2])(places)
    return np.where(np.isfinite(inner), inner, edge)


def render(
    sensor: SensorDescription, face: Face, look: Look | None = None, seed: int | None = None
) -> Image:
    """Return the image of a face.

    Args:
        sensor: The sensor.
        face: What its camera sees.
        look: How it looks.
        seed: Of the camera's noise; None for no noise.

    Raises:
        ConfigError: The face is of another size than the image.
    """
    look = look or Look()
    if face.height_mm.shape != sensor.shape:
        raise ConfigError(f"heights are {face.height_mm.shape}, images {sensor.shape}.")
    if not np.isfinite(face.height_mm).all():
        raise ConfigError("heights are not finite everywhere; give 0 where the face is at rest.")
    rows, columns = np.indices(sensor.shape)
    places = sensor.to_mm(np.stack([columns, rows], axis=-1).reshape(-1, 2).astype(float))
    rest = sensor.gel.height_mm(places).reshape(sensor.shape)
    x, y = sensor.mm_per_px
    light = look.lamps.on(rest + face.height_mm, (float(x), float(y)))
    light *= (1.0 - look.marker_darkness * _covered(sensor, face.markers_px))[..., None]
    if seed is not None and look.noise > 0:
        light += np.random.default_rng(seed).normal(0.0, look.noise, light.shape)
    return np.clip(light.round(), 0, 255).astype(np.uint8)


def _covered(
    sensor: SensorDescription, markers_px: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "h w"]:
    """Share of each pixel that a marker covers, with soft edges."""
    found = np.zeros(sensor.shape)
    if sensor.markers is None:
        return found
    radius = np.array([float(sensor.markers.diameter_mm) / 2 / float(s) for s in sensor.mm_per_px])
    margin = np.ceil(radius + 4 * _SOFT_PX).astype(int)
    height, width = sensor.shape
    for column, row in markers_px:
        left, right = (int(np.clip(round(column) + s * margin[0], 0, width)) for s in (-1, 1))
        top, bottom = (int(np.clip(round(row) + s * margin[1], 0, height)) for s in (-1, 1))
        y, x = np.mgrid[top : bottom + 1, left : right + 1]
        away = np.hypot((x - column) / radius[0], (y - row) / radius[1])
        inside = 1.0 / (1.0 + np.exp(np.clip((away - 1) * radius.mean() / _SOFT_PX * 2, -40, 40)))
        part = found[top : bottom + 1, left : right + 1]
        np.maximum(part, inside[: part.shape[0], : part.shape[1]], out=part)
    return found

"""What the camera of a sensor sees of a deformed gel."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, UInt8
from scipy.interpolate import CloughTocher2DInterpolator, NearestNDInterpolator

from tactorch.sensor.description import SensorDescription
from tactorch.sensor.render import GelSurface, RenderOptions, render

Points = Float[np.ndarray, "g 3"]


class Picture(NamedTuple):
    """Image of a gel.

    Attributes:
        image: Red, green and blue, (h, w, 3).
        height_mm: z of the face at each pixel, relative to rest, (h, w).
        markers_px: Centres of the markers (column, row), (n, 2).
        visible: Markers whose centre is in the image, (n,).
    """

    image: UInt8[np.ndarray, "h w 3"]
    height_mm: Float[np.ndarray, "h w"]
    markers_px: Float[np.ndarray, "n 2"]
    visible: Bool[np.ndarray, " n"]


def draw_gel(
    sensor: SensorDescription,
    points: Points,
    displacement: Points,
    options: RenderOptions,
    seed: int,
) -> Picture:
    """Draw a gel.

    The face is a smooth surface through its nodes (Clough and Tocher, 1965), so that its slopes,
    which the image shows, are continuous.

    Args:
        sensor: The sensor.
        points: Nodes of the gel's face at rest, mm.
        displacement: Their displacement, mm.
        options: Lamps, noise and darkness of the markers.
        seed: Seed of the noise of the camera.
    """
    at = points[:, :2] + displacement[:, :2]
    # Elements have straight sides: on a curved face nodes are not on the face itself.
    risen = displacement[:, 2] + sensor.gel.height_mm(points[:, :2]) - sensor.gel.height_mm(at)
    rows, columns = np.indices(sensor.shape)
    pixels = sensor.to_mm(np.stack([columns, rows], axis=-1).reshape(-1, 2).astype(float))
    found = CloughTocher2DInterpolator(at, risen)(pixels)
    rise = np.where(np.isfinite(found), found, 0.0).reshape(sensor.shape)
    markers = sensor.to_px(_markers(sensor, points, displacement))
    image = render(sensor, GelSurface(rise, markers), options, seed)
    low, high = np.array([-0.5, -0.5]), np.array(sensor.image_size_px) - 0.5
    visible = np.asarray(((markers >= low) & (markers <= high)).all(axis=1))
    return Picture(image, rise, markers, visible)


def _markers(sensor: SensorDescription, points: Points, displacement: Points) -> np.ndarray:
    """Return the positions of the markers, (n, 2), mm."""
    if sensor.markers is None:
        return np.zeros((0, 2))
    at, moved = sensor.markers.positions_mm, displacement[:, :2]
    inside = CloughTocher2DInterpolator(points[:, :2], moved)(at)
    beyond = NearestNDInterpolator(points[:, :2], moved)(at)
    positions: np.ndarray = at + np.where(np.isfinite(inside), inside, beyond)
    return positions

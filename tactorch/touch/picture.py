"""What the camera of a sensor sees of a deformed gel."""

import numpy as np
from jaxtyping import Bool, Float
from scipy.interpolate import CloughTocher2DInterpolator

from tactorch.sensor.description import SensorDescription
from tactorch.sensor.frames import Image
from tactorch.sensor.render import (
    GelSurface,
    RenderOptions,
    marker_positions,
    pixel_positions,
    render,
)

Points = Float[np.ndarray, "g 3"]


def draw_gel(
    sensor: SensorDescription,
    points: Points,
    displacement: Points,
    options: RenderOptions,
    seed: int,
) -> tuple[Image, Float[np.ndarray, "h w"], Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
    """Draw a gel.

    The face is a smooth surface through its nodes (Clough and Tocher, 1965), so that its slopes,
    which the image shows, are continuous. `points` are nodes of the gel's face at rest, mm; the
    seed is that of the noise of the camera.

    Returns:
        The image; z of the face at each pixel, relative to rest, mm; the centres of the markers
        (column, row); and which of these are in the image.
    """
    at = points[:, :2] + displacement[:, :2]
    # Elements have straight sides: on a curved face nodes are not on the face itself.
    risen = displacement[:, 2] + sensor.gel.height_mm(points[:, :2]) - sensor.gel.height_mm(at)
    found = CloughTocher2DInterpolator(at, risen)(pixel_positions(sensor))
    rise = np.where(np.isfinite(found), found, 0.0).reshape(sensor.shape)
    positions = marker_positions(sensor, points, displacement, CloughTocher2DInterpolator)
    markers = sensor.to_px(positions)
    image = render(sensor, GelSurface(rise, markers), options, seed)
    low, high = np.array([-0.5, -0.5]), np.array(sensor.image_size_px) - 0.5
    visible = np.asarray(((markers >= low) & (markers <= high)).all(axis=1))
    return image, rise, markers, visible

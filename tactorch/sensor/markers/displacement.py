"""From followed markers to how the gel's face moved, in mm."""

import numpy as np
from jaxtyping import Float
from scipy.ndimage import map_coordinates

from tactorch.errors import ConfigError
from tactorch.sensor.description import SensorDescription


def displacement_mm(
    sensor: SensorDescription,
    begin_px: Float[np.ndarray, "n 2"],
    places_px: Float[np.ndarray, "n 2"],
    height_mm: Float[np.ndarray, "h w"] | None = None,
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Return where markers rest on the outer face and how they moved, in the sensor's frame, mm.

    The camera looks along z and sees each marker straight before it, one pixel as large as another.

    Args:
        sensor: The sensor.
        begin_px: Markers in the reference (column, row).
        places_px: The same markers in a frame; NaN where one is not seen: so is its displacement.
        height_mm: By how much the face rose toward the object (contact pushes it below 0); None
            takes it not to have moved along z.

    Raises:
        ConfigError: The heights are of another size than the image.
    """
    rest, now = sensor.to_mm(begin_px), sensor.to_mm(places_px)
    flat = sensor.gel.height_mm(rest)
    risen = np.zeros(len(rest))
    if height_mm is not None:
        if height_mm.shape != sensor.shape:
            raise ConfigError(f"heights are {height_mm.shape}, images {sensor.shape}.")
        known = np.isfinite(places_px).all(axis=1)
        columns, rows = places_px[known].T
        # A marker is on the face where the face is now, which at rest was elsewhere.
        risen[known] = map_coordinates(height_mm, [rows, columns], order=1, mode="nearest")
        risen[known] += sensor.gel.height_mm(now[known]) - flat[known]
    points = np.column_stack([rest, flat])
    moved = np.column_stack([now - rest, risen])
    moved[~np.isfinite(moved).all(axis=1)] = np.nan
    return points, moved

"""How the image of a gel changes where it is touched, marker pixels filled in."""

import numpy as np
from jaxtyping import Bool, Float

from tactorch.errors import ConfigError
from tactorch.sensor.depth import filled
from tactorch.sensor.frames import Image
from tactorch.sensor.markers import MarkerLook, marker_mask

#: What a slope is read from: change of the three colours, and the place.
FEATURES = 5
_UNIT = 50.0  # grey values


def hidden(image: Image, reference: Image, look: MarkerLook | None) -> Bool[np.ndarray, "h w"]:
    """Return the pixels that markers cover in an image or covered in the reference."""
    if look is None:
        return np.zeros(image.shape[:2], dtype=bool)
    import cv2

    both = marker_mask(image, look) | marker_mask(reference, look)
    size = 2 * max(1, round(0.15 * look.diameter_px)) + 1  # their soft edges too
    return cv2.dilate(both.astype(np.uint8), np.ones((size, size), np.uint8)) > 0


def change(
    image: Image, reference: Image, look: MarkerLook | None = None, smooth_px: float = 1.0
) -> Float[np.ndarray, "h w 3"]:
    """Return the change of each colour in units of 50 grey values, smoothed.

    Args:
        image: The frame.
        reference: The gel without contact.
        look: How markers look, to be filled in; None where there are none.
        smooth_px: Standard deviation of the smoothing.

    Raises:
        ConfigError: The images have different sizes.
    """
    import cv2

    if image.shape != reference.shape:
        raise ConfigError(
            f"the image has shape {image.shape}, the reference {reference.shape}; give rectified"
            " images of one sensor."
        )
    difference = (image.astype(np.float64) - reference) / _UNIT
    known = ~hidden(image, reference, look)
    if not known.all():
        channels = [filled(difference[..., k], known) for k in range(3)]
        difference = np.stack(channels, axis=-1)
    return cv2.GaussianBlur(difference, (0, 0), smooth_px) if smooth_px > 0 else difference


def features(changed: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "h w 5"]:
    """Put each pixel's place beside its change, from -1 to 1 across the image."""
    rows, columns = changed.shape[:2]
    y, x = np.mgrid[:rows, :columns]
    place = np.stack([2 * x / (columns - 1) - 1, 2 * y / (rows - 1) - 1], axis=-1)
    return np.concatenate([changed, place], axis=-1)

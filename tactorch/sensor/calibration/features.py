"""Features of pixels from which slopes are predicted: change of color and position."""

import numpy as np
from jaxtyping import Bool, Float

from tactorch.errors import ConfigError
from tactorch.sensor.depth import fill_masked
from tactorch.sensor.frames import Image
from tactorch.sensor.markers import MarkerAppearance, marker_mask

#: Number of features: change of the three colors, and position x, y.
FEATURES = 5
_UNIT = 50.0  # gray values


def marker_pixels(
    image: Image, reference: Image, markers: MarkerAppearance | None
) -> Bool[np.ndarray, "h w"]:
    """Return the pixels covered by markers in an image or in the reference."""
    if markers is None:
        return np.zeros(image.shape[:2], dtype=bool)
    import cv2

    covered = marker_mask(image, markers) | marker_mask(reference, markers)
    size = 2 * max(1, round(0.15 * markers.diameter_px)) + 1  # includes blurred edges
    return cv2.dilate(covered.astype(np.uint8), np.ones((size, size), np.uint8)) > 0


def image_change(
    image: Image,
    reference: Image,
    markers: MarkerAppearance | None = None,
    smooth_px: float = 1.0,
) -> Float[np.ndarray, "h w 3"]:
    """Return the smoothed change of each color in units of 50 gray values.

    Args:
        image: Frame.
        reference: Image of the gel without contact.
        markers: Appearance of markers, whose pixels are filled in; None without markers.
        smooth_px: Standard deviation of the smoothing.

    Returns:
        The change.

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
    known = ~marker_pixels(image, reference, markers)
    if not known.all():
        channels = [fill_masked(difference[..., k], known) for k in range(3)]
        difference = np.stack(channels, axis=-1)
    return cv2.GaussianBlur(difference, (0, 0), smooth_px) if smooth_px > 0 else difference


def pixel_features(change: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "p 5"]:
    """Return the change and the position, from -1 to 1 across the image, of each pixel."""
    rows, columns = change.shape[:2]
    y, x = np.mgrid[:rows, :columns]
    position = np.stack([2 * x / (columns - 1) - 1, 2 * y / (rows - 1) - 1], axis=-1)
    return np.concatenate([change, position], axis=-1).reshape(-1, FEATURES)

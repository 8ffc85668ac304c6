"""Optical flow at markers (pyramidal Lucas-Kanade; Bouguet, 2001), checked forward and back."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from tactorch.sensor.image import Image

_LEVELS = 3


def followed(
    before: Image,
    after: Image,
    places: Float[np.ndarray, "n 2"],
    diameter_px: float,
    back_px: float,
) -> tuple[Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
    """Return where places of an image are in the next, and which come out where they began.

    Args:
        before: An image.
        after: The next.
        places: In the first (column, row), px.
        diameter_px: Of a marker; twice as much is looked at.
        back_px: Distance after going forward and back up to which a place is sure.
    """
    import cv2

    size = 2 * round(diameter_px) + 1
    first, second = (image.max(axis=2) for image in (before, after))
    start = places.astype(np.float32)[:, None]
    none: Any = None  # of OpenCV, for what it makes itself
    there, good, _ = cv2.calcOpticalFlowPyrLK(
        first, second, start, none, winSize=(size, size), maxLevel=_LEVELS
    )
    back, well, _ = cv2.calcOpticalFlowPyrLK(
        second, first, there, none, winSize=(size, size), maxLevel=_LEVELS
    )
    apart = np.linalg.norm((back - start)[:, 0], axis=1)
    sure = (good[:, 0] == 1) & (well[:, 0] == 1) & (apart <= back_px)
    return there[:, 0].astype(np.float64), np.asarray(sure)

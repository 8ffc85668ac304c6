"""Optical flow at markers (pyramidal Lucas-Kanade; Bouguet, 2001), checked forward and back."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from tactorch.sensor.frames import Image

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


def sharpened(
    first: Float[np.ndarray, "h w"],
    second: Float[np.ndarray, "h w"],
    begin: Float[np.ndarray, "n 2"],
    places: Float[np.ndarray, "n 2"],
    diameter_px: float,
) -> Float[np.ndarray, "n 2"]:
    """Return places moved to where a marker's surroundings fit those at its beginning best.

    Comparing whole patches is less noisy than comparing centres of darkness. A place that would
    move by more than a fifth of a marker stays; so does one that is not known (NaN).

    Args:
        first: Darkness of the reference, from 0 to 1.
        second: Darkness of the image.
        begin: Of each marker in the reference (column, row), px.
        places: Of each in the image, to a pixel or so.
        diameter_px: Of a marker.
    """
    import cv2

    known = ~np.isnan(places[:, 0])
    if not known.any():
        return places
    size = 2 * round(0.8 * diameter_px) + 1
    one, other = ((255 * np.clip(d, 0, 1)).astype(np.uint8) for d in (first, second))
    guess = places[known].astype(np.float32)[:, None]
    found, good, _ = cv2.calcOpticalFlowPyrLK(
        one, other, begin[known].astype(np.float32)[:, None], guess.copy(),
        winSize=(size, size), maxLevel=0, flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 0.002),
    )  # fmt: skip
    moved = np.linalg.norm((found - guess)[:, 0], axis=1)
    taken = (good[:, 0] == 1) & (moved < 0.2 * diameter_px)
    sharp = places.copy()
    sharp[known] = np.where(taken[:, None], found[:, 0], places[known])
    return sharp

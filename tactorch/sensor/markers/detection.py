"""Detection of dark markers in an image with subpixel accuracy."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from tactorch.config import Options, option
from tactorch.sensor.frames import Image

_MIN_BACKGROUND = 10.0  # gray values; below, contrast is not defined


@dataclass(frozen=True)
class MarkerAppearance(Options):
    """Appearance of markers in an image."""

    diameter_px: float = option(help="Diameter of a typical marker", unit="px", ge=2, le=200)
    min_area: float = option(
        0.25, "Smallest area of a marker, as a fraction of the typical area", gt=0, lt=1
    )
    max_area: float = option(
        6.0, "Largest area of a spot that may be several markers, over the typical area", gt=1
    )
    contrast: float | None = option(
        None, "Relative darkness at a marker's edge; null estimates it from the image", gt=0, lt=1
    )

    @property
    def area_px(self) -> float:
        """Area of a typical marker."""
        return float(np.pi / 4 * self.diameter_px**2)


def relative_darkness(image: Image, appearance: MarkerAppearance) -> Float[np.ndarray, "h w"]:
    """Return how much darker each pixel is than its surroundings: 0 as bright, 1 black.

    Markers are dark in every color, colored light is not. The brightest of the three colors is
    therefore compared with its median over a window that is wider than a marker.
    """
    import cv2

    brightest = image.max(axis=2)
    size = 2 * round(0.7 * np.sqrt(appearance.max_area) * appearance.diameter_px) + 1
    margin = size // 2
    padded = cv2.copyMakeBorder(brightest, margin, margin, margin, margin, cv2.BORDER_REFLECT)
    background = cv2.medianBlur(padded, size)[margin:-margin, margin:-margin]
    smooth = cv2.GaussianBlur(brightest.astype(np.float32), (0, 0), 0.7)
    return np.maximum(1.0 - smooth / np.maximum(background, _MIN_BACKGROUND), 0.0).astype(
        np.float64
    )


def marker_mask(image: Image, appearance: MarkerAppearance) -> Bool[np.ndarray, "h w"]:
    """Return the pixels of markers, including dirt of the same darkness."""
    darkness = relative_darkness(image, appearance)
    return np.asarray(darkness > _threshold(darkness, appearance))


def _threshold(darkness: Float[np.ndarray, "h w"], appearance: MarkerAppearance) -> float:
    """Half the darkness of markers; Otsu's threshold fails where most pixels are background."""
    if appearance.contrast is not None:
        return appearance.contrast
    median = float(np.median(darkness))
    noise = 1.4826 * float(np.median(np.abs(darkness - median)))
    background = median + 6 * max(noise, 0.01)
    spots = darkness[darkness > background]
    return max(0.5 * float(np.percentile(spots, 75)), background) if len(spots) else 1.0


def detect_markers(image: Image, appearance: MarkerAppearance) -> Float[np.ndarray, "n 2"]:
    """Return the centers (column, row) of the markers in an image, from the top down.

    Spots of several merged markers are split at their necks. Each center is the centroid of the
    darkness, which averages noise and partly covered pixels.
    """
    return locate_markers(relative_darkness(image, appearance), appearance)


def locate_markers(
    darkness: Float[np.ndarray, "h w"], appearance: MarkerAppearance
) -> Float[np.ndarray, "n 2"]:
    """Return the centers (column, row) of the markers, given the relative darkness of an image."""
    threshold = _threshold(darkness, appearance)
    labels = _label_spots(np.asarray(darkness > threshold), appearance)
    return _centroids(darkness, labels, threshold)


def _label_spots(
    mask: Bool[np.ndarray, "h w"], appearance: MarkerAppearance
) -> Int[np.ndarray, "h w"]:
    """Label the spots that may be markers, from 1."""
    import cv2

    # Bright specks within a marker must not split it.
    size = max(1, round(0.3 * appearance.diameter_px))
    closed = cv2.morphologyEx(
        mask.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((size, size), np.uint8)
    )
    count, labels, statistics, _ = cv2.connectedComponentsWithStats(closed, connectivity=4)
    areas = statistics[:, cv2.CC_STAT_AREA] / appearance.area_px
    accepted = (areas >= appearance.min_area) & (areas <= appearance.max_area)
    accepted[0] = False
    labels = np.where(accepted[labels], labels, 0)
    for label in np.flatnonzero(accepted & (areas > 1.6)):
        count = _split_spot(labels, int(label), count, statistics[label], appearance)
    return labels


def _split_spot(
    labels: Int[np.ndarray, "h w"],
    label: int,
    count: int,
    statistics: Int[np.ndarray, " statistics"],
    appearance: MarkerAppearance,
) -> int:
    """Split a spot with a neck in place; return the new number of labels."""
    import cv2
    from skimage.feature import peak_local_max
    from skimage.segmentation import watershed

    left, top, width, height = (int(v) for v in statistics[:4])
    window = labels[top : top + height, left : left + width]
    spot = window == label
    distance = cv2.distanceTransform(np.pad(spot, 1).astype(np.uint8), cv2.DIST_L2, 5)[1:-1, 1:-1]
    smooth = cv2.GaussianBlur(distance, (0, 0), 1.0)
    peaks = peak_local_max(
        smooth, min_distance=max(2, round(0.45 * appearance.diameter_px)), labels=spot.astype(int)
    )
    if len(peaks) < 2:
        return count
    seeds = np.zeros(spot.shape, dtype=np.int32)
    seeds[tuple(peaks.T)] = np.arange(1, len(peaks) + 1)
    pieces = watershed(-smooth, seeds, mask=spot)
    if not _has_necks(pieces, distance, peaks):
        return count
    window[spot] = np.where(pieces[spot] > 1, pieces[spot] - 2 + count, label)
    return count + len(peaks) - 1


def _has_necks(
    pieces: Int[np.ndarray, "h w"],
    distance: Float[np.ndarray, "h w"],
    peaks: Int[np.ndarray, "k 2"],
) -> bool:
    """Return whether a spot is clearly narrower where its pieces meet than at their centers."""
    horizontal = (pieces[:, 1:] != pieces[:, :-1]) & (pieces[:, 1:] > 0) & (pieces[:, :-1] > 0)
    vertical = (pieces[1:] != pieces[:-1]) & (pieces[1:] > 0) & (pieces[:-1] > 0)
    border = np.concatenate([distance[:, 1:][horizontal], distance[1:][vertical]])
    return bool(len(border) and border.max() < 0.8 * distance[tuple(peaks.T)].min())


def _centroids(
    darkness: Float[np.ndarray, "h w"], labels: Int[np.ndarray, "h w"], threshold: float
) -> Float[np.ndarray, "n 2"]:
    """Centroids of the darkness in excess of half the threshold, in and next to each spot."""
    import cv2

    dilated = cv2.dilate(labels.astype(np.float32), np.ones((3, 3), np.uint8)).astype(np.int64)
    dilated = np.where(labels > 0, labels, dilated)
    weight = np.maximum(darkness - 0.5 * threshold, 0.0)
    spots, index = np.unique(dilated, return_inverse=True)
    index = index.reshape(-1)
    mass = np.bincount(index, weight.ravel())
    rows, columns = np.indices(labels.shape)
    x, y = (np.bincount(index, (weight * v).ravel()) for v in (columns, rows))
    selected = (spots > 0) & (mass > 0)
    centers = np.stack([x[selected], y[selected]], axis=1) / mass[selected][:, None]
    return centers[np.lexsort((centers[:, 0], centers[:, 1]))]

"""Finding dark markers in an image, to a fraction of a pixel."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from tactorch.errors import ConfigError
from tactorch.sensor.frames import Image

_LEAST = 10.0  # grey values: darker surroundings tell nothing


@dataclass(frozen=True)
class MarkerLook:
    """How markers look in an image.

    Attributes:
        diameter_px: Of a typical marker.
        smallest: Share of a typical marker's area below which a dark spot is dirt.
        largest: Typical areas above which a dark spot is no marker, or several.
        contrast: Share by which a marker's edge is darker than what surrounds it; None finds it
            from the image.

    Raises:
        ConfigError: A value cannot be used; the message names it.
    """

    diameter_px: float
    smallest: float = 0.25
    largest: float = 6.0
    contrast: float | None = None

    def __post_init__(self) -> None:
        if not 2.0 <= self.diameter_px <= 200.0:
            raise ConfigError(f"diameter_px={self.diameter_px:g}: markers have 2 to 200 px.")
        if not 0 < self.smallest < 1 < self.largest:
            raise ConfigError(
                f"smallest={self.smallest:g}, largest={self.largest:g}: give shares of a typical"
                " area, one below and one above 1."
            )
        if self.contrast is not None and not 0 < self.contrast < 1:
            raise ConfigError(f"contrast={self.contrast:g}: give a share, between 0 and 1.")

    @property
    def area_px(self) -> float:
        """Area of a typical marker."""
        return float(np.pi / 4 * self.diameter_px**2)


def darkness(image: Image, look: MarkerLook) -> Float[np.ndarray, "h w"]:
    """Return by what share each pixel is darker than what surrounds markers: 0 as bright, 1 black.

    Markers are dark in every colour, and coloured light is not; so looked at is the brightest of
    the three colours, against its median over a window that is wider than a marker.
    """
    import cv2

    brightest = image.max(axis=2)
    size = 2 * round(0.7 * np.sqrt(look.largest) * look.diameter_px) + 1
    margin = size // 2
    padded = cv2.copyMakeBorder(brightest, margin, margin, margin, margin, cv2.BORDER_REFLECT)
    around = cv2.medianBlur(padded, size)[margin:-margin, margin:-margin]
    smooth = cv2.GaussianBlur(brightest.astype(np.float32), (0, 0), 0.7)
    return np.maximum(1.0 - smooth / np.maximum(around, _LEAST), 0.0).astype(np.float64)


def marker_mask(image: Image, look: MarkerLook) -> Bool[np.ndarray, "h w"]:
    """Return which pixels are of markers, dirt of the same darkness included."""
    depth = darkness(image, look)
    return np.asarray(depth > _threshold(depth, look))


def _threshold(depth: Float[np.ndarray, "h w"], look: MarkerLook) -> float:
    """Half as dark as markers are (Otsu's threshold misses markers where most pixels have none)."""
    if look.contrast is not None:
        return look.contrast
    noise = 1.4826 * float(np.median(np.abs(depth - np.median(depth))))
    usual = float(np.median(depth)) + 6 * max(noise, 0.01)
    spots = depth[depth > usual]
    return max(0.5 * float(np.percentile(spots, 75)), usual) if len(spots) else 1.0


def detect_markers(image: Image, look: MarkerLook) -> Float[np.ndarray, "n 2"]:
    """Return the centres (column, row) of the markers in an image, from the top down.

    Spots that are several markers in one are divided where they are narrow; each centre is that
    of the darkness around it, so noise and the edges' pixels average out.
    """
    return markers_in(darkness(image, look), look)


def markers_in(depth: Float[np.ndarray, "h w"], look: MarkerLook) -> Float[np.ndarray, "n 2"]:
    """Return the centres (column, row) of the markers, given the darkness of an image."""
    threshold = _threshold(depth, look)
    return _centers(depth, _spots(np.asarray(depth > threshold), look), threshold)


def _spots(mask: Bool[np.ndarray, "h w"], look: MarkerLook) -> Int[np.ndarray, "h w"]:
    """Number the spots that may be markers, from 1."""
    import cv2

    # Specks of light within a marker must not divide it.
    size = max(1, round(0.3 * look.diameter_px))
    filled = cv2.morphologyEx(
        mask.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((size, size), np.uint8)
    )
    count, labels, facts, _ = cv2.connectedComponentsWithStats(filled, connectivity=4)
    areas = facts[:, cv2.CC_STAT_AREA]
    good = (areas >= look.smallest * look.area_px) & (areas <= look.largest * look.area_px)
    good[0] = False
    labels = np.where(good[labels], labels, 0)
    for label in np.flatnonzero(good):
        if areas[label] > 1.6 * look.area_px:
            count = _divide(labels, int(label), count, facts[label], look)
    return labels


def _divide(
    labels: Int[np.ndarray, "h w"],
    label: int,
    count: int,
    fact: Int[np.ndarray, " facts"],
    look: MarkerLook,
) -> int:
    """Divide a spot that is waisted; return how many numbers are taken now."""
    import cv2
    from skimage.feature import peak_local_max
    from skimage.segmentation import watershed

    left, top, width, height = (int(v) for v in fact[:4])
    part = labels[top : top + height, left : left + width]
    own = part == label
    inner = cv2.distanceTransform(np.pad(own, 1).astype(np.uint8), cv2.DIST_L2, 5)[1:-1, 1:-1]
    smooth = cv2.GaussianBlur(inner, (0, 0), 1.0)
    peaks = peak_local_max(
        smooth, min_distance=max(2, round(0.45 * look.diameter_px)), labels=own.astype(int)
    )
    if len(peaks) < 2:
        return count
    seeds = np.zeros(own.shape, dtype=np.int32)
    seeds[tuple(peaks.T)] = np.arange(1, len(peaks) + 1)
    pieces = watershed(-smooth, seeds, mask=own)
    if not _waisted(pieces, inner, peaks):
        return count
    part[own] = np.where(pieces[own] > 1, pieces[own] - 2 + count, label)
    return count + len(peaks) - 1


def _waisted(
    pieces: Int[np.ndarray, "h w"], inner: Float[np.ndarray, "h w"], peaks: Int[np.ndarray, "k 2"]
) -> bool:
    """Tell whether pieces meet where the spot is clearly narrower than at their middles."""
    sideways = (pieces[:, 1:] != pieces[:, :-1]) & (pieces[:, 1:] > 0) & (pieces[:, :-1] > 0)
    down = (pieces[1:] != pieces[:-1]) & (pieces[1:] > 0) & (pieces[:-1] > 0)
    border = np.concatenate([inner[:, 1:][sideways], inner[1:][down]])
    return bool(len(border) and border.max() < 0.8 * inner[tuple(peaks.T)].min())


def _centers(
    depth: Float[np.ndarray, "h w"], labels: Int[np.ndarray, "h w"], threshold: float
) -> Float[np.ndarray, "n 2"]:
    """Centroids of the darkness over half the threshold, in and right around each spot."""
    import cv2

    wide = cv2.dilate(labels.astype(np.float32), np.ones((3, 3), np.uint8)).astype(np.int64)
    wide = np.where(labels > 0, labels, wide)
    weight = np.maximum(depth - 0.5 * threshold, 0.0)
    numbers, places = np.unique(wide, return_inverse=True)
    places = places.reshape(-1)
    mass = np.bincount(places, weight.ravel())
    rows, columns = np.indices(labels.shape)
    x, y = (np.bincount(places, (weight * v).ravel()) for v in (columns, rows))
    kept = (numbers > 0) & (mass > 0)
    found = np.stack([x[kept] / mass[kept], y[kept] / mass[kept]], axis=1)
    return found[np.lexsort((found[:, 0], found[:, 1]))]

"""Finding the outline of a flat face of known shape that is pressed into a gel.

Under a flat face the gel stays level; around it its face slopes, steepest right beside the edge.
So the colours' change rises suddenly, going out, where the edge is. About where the outline is, of
what size and turn, is found by comparing that rise with the shape's outline everywhere (a
generalised Hough transform; Ballard, 1981); then each edge on its own, see `edges`.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from scipy import fft
from scipy.ndimage import map_coordinates
from scipy.optimize import minimize

from tactorch.errors import ConfigError
from tactorch.sensor.description import pixel_size
from tactorch.sensor.scale.edges import refined
from tactorch.sensor.scale.shape import KnownShape, Outline

_LEAST_CHANGE = 0.1  # in units of `change`: 5 grey values
_SEARCHED_PX, _STRETCHED_PX = 80, 160  # of images in which it is looked for, and made to fit
_RANGE, _STEP = 1.7, 1.04  # of the scale about the expected one
_NARROW_PX, _WIDE_PX = 1.2, 4.0  # of smoothing there
_TURN_PX = 1.5  # that a corner goes from one turn tried to the next


def find_outline(
    changed: Float[np.ndarray, "h w 3"],
    shape: KnownShape,
    mm_per_px: tuple[float, float],
    known: Bool[np.ndarray, "h w"] | None = None,
    name: str = "image",
) -> Outline:
    """Return the outline of a face that is pressed into the gel, to a fraction of a pixel.

    Args:
        changed: Change of the colours against the reference, see `change`; little smoothed, for
            that blurs edges (`smooth_px=0.5`, say).
        shape: What was pressed.
        mm_per_px: About the size of a pixel along x and y, mm; it may be wrong by half.
        known: Pixels that no marker covers; None for all.
        name: Of the image, for messages.

    Raises:
        ConfigError: No such outline is seen; the message names the image.
    """
    pixel_size("mm_per_px", mm_per_px)
    if not np.isfinite(changed).all():
        raise ConfigError(f"{name}: the change of its colours is not finite; is the image whole?")
    seen = np.ones(changed.shape[:2], dtype=bool) if known is None else known
    strength = np.linalg.norm(changed, axis=-1)
    if float(np.percentile(strength[seen], 99)) < _LEAST_CHANGE:
        raise ConfigError(f"{name}: no {shape.name} found; nothing changed against the reference.")
    rough = _about(strength, seen, shape, mm_per_px, name)
    return refined(changed, seen, rough, shape, name)


def _about(
    strength: Float[np.ndarray, "h w"],
    known: Bool[np.ndarray, "h w"],
    shape: KnownShape,
    mm_per_px: tuple[float, float],
    name: str,
) -> Float[np.ndarray, "n 2"]:
    """Corners of the shape where the change rises across its outline most, to some pixels."""
    small, seen, factor = _shrunk(strength, known, _SEARCHED_PX)
    rise = _rise(small, seen, _NARROW_PX)
    padded = tuple(fft.next_fast_len(n) for n in rise.shape)
    waves = fft.fft2(rise, padded)
    best, corners = 0.0, None
    for candidate in _candidates(shape, np.array(mm_per_px) / factor, small.shape):
        score = _scores(waves, candidate, rise.shape, padded)
        top = np.unravel_index(int(score.argmax()), score.shape)
        if score[top] > best:
            best, corners = float(score[top]), candidate + np.array(top[::-1], float)
    if corners is None:
        raise ConfigError(
            f"{name}: no {shape.name} found; none of its size fits into the image. Check its size"
            " in mm and mm_per_px."
        )
    whole = (corners + 0.5) / factor - 0.5
    small, seen, factor = _shrunk(strength, known, _STRETCHED_PX)
    rises = [_rise(small, seen, blur_px) for blur_px in (_WIDE_PX, _NARROW_PX)]
    return (_stretched(rises, (whole + 0.5) * factor - 0.5) + 0.5) / factor - 0.5


def _shrunk(
    strength: Float[np.ndarray, "h w"], known: Bool[np.ndarray, "h w"], max_px: int
) -> tuple[np.ndarray, np.ndarray, Float[np.ndarray, "2"]]:
    """An image of so many pixels at most, what is known of it, and its size over the old one's."""
    import cv2

    rows, columns = strength.shape
    part = min(1.0, max_px / max(rows, columns))
    size = (max(8, round(columns * part)), max(8, round(rows * part)))
    small = cv2.resize(strength, size, interpolation=cv2.INTER_AREA)
    seen = cv2.resize(known.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    return small, seen, np.array([size[0] / columns, size[1] / rows])


def _rise(
    strength: Float[np.ndarray, "h w"], known: Bool[np.ndarray, "h w"], blur_px: float
) -> np.ndarray:
    """Gradient of the change, x + iy; strong ones count no more than many do."""
    import cv2

    smooth = cv2.GaussianBlur(strength, (0, 0), blur_px)
    down, across = np.gradient(smooth)
    found = np.where(known, across + 1j * down, 0.0)
    size = np.abs(found)
    limit = max(float(np.percentile(size, 90)), 1e-12)
    return found * np.minimum(1.0, limit / np.maximum(size, 1e-12))


def _candidates(shape: KnownShape, mm_per_px: np.ndarray, size: tuple[int, ...]) -> list:
    """Corners in pixels about the middle, for scales and turns, that fit into the image."""
    own, found = shape.corners, []
    count = int(np.log(_RANGE) / np.log(_STEP))
    for scale in _STEP ** np.arange(-count, count + 1.0):
        reach = float(np.linalg.norm(own, axis=1).max()) / (scale * float(mm_per_px.min()))
        turns = max(2, int(np.ceil(shape.turn_rad * reach / _TURN_PX)))
        for turn in np.arange(turns) * shape.turn_rad / turns:
            c, s = np.cos(turn), np.sin(turn)
            corners = own @ np.array([(c, s), (-s, c)]) / (scale * mm_per_px)
            if (np.ptp(corners, axis=0) < size[::-1]).all():
                found.append(corners)
    return found


def _stretched(
    rises: Sequence[np.ndarray], corners: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 2"]:
    """Corners moved, turned and stretched to where the change rises across the outline most.

    Pixels may be of another shape than expected, which the search over places does not vary. What
    is smoothed widely tells about where, what is smoothed narrowly then where.
    """
    middle = corners.mean(axis=0)
    own, reach = corners - middle, float(np.linalg.norm(corners - middle, axis=1).max())

    def placed(change: Float[np.ndarray, "5"]) -> Float[np.ndarray, "n 2"]:
        c, s = np.cos(change[2]), np.sin(change[2])
        turned = own @ np.array([(c, s), (-s, c)])
        return turned * np.exp(change[3:]) + middle + change[:2] * reach

    found = []
    for stretch in (-0.1, 0.0, 0.1):
        best = np.array([0.0, 0.0, 0.0, stretch, -stretch])
        for rise in rises:
            simplex = np.vstack([best, best + np.diag([0.05, 0.05, 0.08, 0.06, 0.06])])
            options = {"initial_simplex": simplex, "xatol": 1e-3, "fatol": 1e-6, "maxfev": 400}
            best = minimize(
                lambda change, rise=rise: -_mean_rise(rise, placed(change)),
                best, method="Nelder-Mead", options=options,
            ).x  # fmt: skip
        found.append(best)
    return placed(max(found, key=lambda change: _mean_rise(rises[-1], placed(change))))


def _mean_rise(rise: np.ndarray, corners: Float[np.ndarray, "n 2"]) -> float:
    """Mean over the edges of the rise across them, outward."""
    total = 0.0
    for begin, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        along = end - begin
        length = max(float(np.linalg.norm(along)), 1e-9)
        places = begin + (np.arange(0.05, 1.0, 0.03))[:, None] * along
        at = [places[:, 1], places[:, 0]]
        x, y = (map_coordinates(part, at, order=1, cval=0.0) for part in (rise.real, rise.imag))
        total += float(np.mean(x * along[1] - y * along[0])) / length
    return total / len(corners)


def _scores(
    waves: np.ndarray, corners: Float[np.ndarray, "n 2"], shape: tuple[int, ...], padded: tuple
) -> Float[np.ndarray, "h w"]:
    """Mean rise across an outline, outward, for each place of its middle; 0 where it sticks out."""
    template = np.zeros(padded, dtype=complex)
    count = 0
    for begin, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        along = end - begin
        length = float(np.linalg.norm(along))
        outward = complex(along[1], -along[0]) / length
        steps = (np.arange(round(length)) + 0.5) / max(1, round(length))
        places = np.rint(begin + steps[:, None] * along).astype(int)
        np.add.at(template, (places[:, 1] % padded[0], places[:, 0] % padded[1]), outward)
        count += len(steps)
    found = fft.ifft2(waves * np.conj(fft.fft2(template))).real[: shape[0], : shape[1]] / count
    low, high = np.ceil(-corners.min(axis=0)), np.floor(corners.max(axis=0))
    inside = np.zeros(shape, dtype=bool)
    inside[
        max(0, int(low[1])) : max(0, int(shape[0] - high[1])),
        max(0, int(low[0])) : max(0, int(shape[1] - high[0])),
    ] = True
    return np.where(inside, found, 0.0)

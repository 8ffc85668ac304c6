"""Detection of the outline of a flat face of known shape that is pressed into a gel.

Under a flat face the gel stays level; around it its face is sloped, most steeply next to the edge.
The change of color therefore jumps outward at the edge. An approximate position, size and rotation
maximize the correlation of this jump with the outline (generalized Hough transform; Ballard, 1981);
then each edge is fitted separately, see `edges`.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float
from scipy import fft
from scipy.ndimage import map_coordinates
from scipy.optimize import minimize

from tactorch.errors import ConfigError
from tactorch.sensor.description import check_pixel_size
from tactorch.sensor.scale.edges import refine_outline
from tactorch.sensor.scale.shape import Corners, KnownShape, Outline, rotate, sides

_MIN_CHANGE = 0.1  # of the colors: 5 gray values
_SEARCH_PX, _FIT_PX = 80, 160  # size of the downscaled images
_SCALE_RANGE, _SCALE_STEP = 1.7, 1.04  # relative to the expected scale
_NARROW_BLUR_PX, _WIDE_BLUR_PX = 1.2, 4.0
_ROTATION_STEP_PX = 1.5  # of a corner

Gray = Float[np.ndarray, "h w"]
Mask = Bool[np.ndarray, "h w"]


def find_outline(
    change: Float[np.ndarray, "h w 3"],
    shape: KnownShape,
    mm_per_px: tuple[float, float],
    known: Bool[np.ndarray, "h w"] | None = None,
    name: str = "image",
) -> Outline:
    """Return the outline of a face that is pressed into the gel, with subpixel accuracy.

    Args:
        change: Change of the colors against the reference, see `image_change`, with little
            smoothing (such as `smooth_px=0.5`), which blurs edges.
        shape: Pressed shape.
        mm_per_px: Approximate size of a pixel along x and y, mm, within 50 %.
        known: Pixels not covered by markers; None for all.
        name: Name of the image, for messages.

    Raises:
        ConfigError: There is no such outline; the message names the image.
    """
    check_pixel_size(mm_per_px)
    if not np.isfinite(change).all():
        raise ConfigError(f"{name}: the change of its colors is not finite; give a whole image.")
    visible = np.ones(change.shape[:2], dtype=bool) if known is None else known
    strength = np.linalg.norm(change, axis=-1)
    if float(np.percentile(strength[visible], 99)) < _MIN_CHANGE:
        raise ConfigError(f"{name}: no {shape.name} found; nothing changed against the reference.")
    small, mask, factor = _downscale(strength, visible, _SEARCH_PX)
    gradient = _gradient(small, mask, _NARROW_BLUR_PX)
    spectrum = fft.fft2(gradient, tuple(fft.next_fast_len(n) for n in gradient.shape))
    best, corners = 0.0, None  # those with the largest jump of the change across the outline
    for candidate in _candidates(shape, np.array(mm_per_px) / factor, small.shape):
        score = _scores(spectrum, candidate, gradient.shape)
        row, column = np.unravel_index(int(score.argmax()), score.shape)
        if score[row, column] > best:
            best, corners = float(score[row, column]), candidate + np.array([column, row])
    if corners is None:
        raise ConfigError(
            f"{name}: no {shape.name} found; none of its size fits into the image. Check its size"
            " in mm and mm_per_px."
        )
    positions = (corners + 0.5) / factor  # relative to the corner of the first pixel
    small, mask, factor = _downscale(strength, visible, _FIT_PX)
    gradients = [_gradient(small, mask, blur) for blur in (_WIDE_BLUR_PX, _NARROW_BLUR_PX)]
    rough = (_fit_placement(gradients, positions * factor - 0.5) + 0.5) / factor - 0.5
    return refine_outline(change, visible, rough, shape, name)


def _downscale(
    strength: Gray, known: Mask, max_px: int
) -> tuple[np.ndarray, np.ndarray, Float[np.ndarray, "2"]]:
    """Downscaled image, its known pixels, and the scale factors along x and y."""
    rows, columns = strength.shape
    ratio = min(1.0, max_px / max(rows, columns))
    size = (max(8, round(columns * ratio)), max(8, round(rows * ratio)))
    small = cv2.resize(strength, size, interpolation=cv2.INTER_AREA)
    visible = cv2.resize(known.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    return small, visible, np.array([size[0] / columns, size[1] / rows])


def _gradient(strength: Gray, known: Mask, blur_px: float) -> np.ndarray:
    """Gradient of the change as x + iy, with its magnitude clipped."""
    smooth = cv2.GaussianBlur(strength, (0, 0), blur_px)
    along_y, along_x = np.gradient(smooth)
    gradient = np.where(known, along_x + 1j * along_y, 0.0)
    magnitude = np.abs(gradient)
    limit = max(float(np.percentile(magnitude, 90)), 1e-12)
    return gradient * np.minimum(1.0, limit / np.maximum(magnitude, 1e-12))


def _candidates(shape: KnownShape, mm_per_px: np.ndarray, size: tuple[int, ...]) -> list:
    """Corners in pixels about the center, for all scales and rotations that fit into the image."""
    corners_mm, candidates = shape.corners, []
    count = int(np.log(_SCALE_RANGE) / np.log(_SCALE_STEP))
    radius_mm = float(np.linalg.norm(corners_mm, axis=1).max())
    for scale in _SCALE_STEP ** np.arange(-count, count + 1.0):
        radius = radius_mm / (scale * float(mm_per_px.min()))
        rotations = max(2, int(np.ceil(shape.symmetry_rad * radius / _ROTATION_STEP_PX)))
        for angle in np.arange(rotations) * shape.symmetry_rad / rotations:
            corners = rotate(corners_mm, float(angle)) / (scale * mm_per_px)
            if (np.ptp(corners, axis=0) < size[::-1]).all():
                candidates.append(corners)
    return candidates


def _fit_placement(gradients: Sequence[np.ndarray], corners: Corners) -> Corners:
    """Translate, rotate and stretch corners to the largest jump of the change across the outline.

    The aspect ratio of pixels may differ from the expected one, which the search does not vary. The
    result for a wide blur is the start for a narrow one.
    """
    center = corners.mean(axis=0)
    offsets = corners - center
    radius = float(np.linalg.norm(offsets, axis=1).max())

    def place(parameters: Float[np.ndarray, "5"]) -> Corners:
        rotated = rotate(offsets, float(parameters[2]))
        return rotated * np.exp(parameters[3:]) + center + parameters[:2] * radius

    results = []
    for stretch in (-0.1, 0.0, 0.1):
        best = np.array([0.0, 0.0, 0.0, stretch, -stretch])
        for gradient in gradients:
            simplex = np.vstack([best, best + np.diag([0.05, 0.05, 0.08, 0.06, 0.06])])
            options = {"initial_simplex": simplex, "xatol": 1e-3, "fatol": 1e-6, "maxfev": 400}
            best = minimize(
                lambda parameters, gradient=gradient: -_mean_gradient(gradient, place(parameters)),
                best, method="Nelder-Mead", options=options,
            ).x  # fmt: skip
        results.append(best)
    return place(max(results, key=lambda result: _mean_gradient(gradients[-1], place(result))))


def _mean_gradient(gradient: np.ndarray, corners: Corners) -> float:
    """Mean outward gradient over the edges."""
    total = 0.0
    for start, end in sides(corners):
        edge = end - start
        length = max(float(np.linalg.norm(edge)), 1e-9)
        points = start + (np.arange(0.05, 1.0, 0.03))[:, None] * edge
        indices = [points[:, 1], points[:, 0]]
        along = map_coordinates(gradient, indices, order=1, cval=0.0)
        total += float(np.mean(along.real * edge[1] - along.imag * edge[0])) / length
    return total / len(corners)


def _scores(spectrum: np.ndarray, corners: Corners, shape: tuple[int, ...]) -> Gray:
    """Mean outward gradient for each position of the center; 0 if the outline leaves the image."""
    template, count = np.zeros(spectrum.shape, dtype=complex), 0
    for start, end in sides(corners):
        edge = end - start
        length = float(np.linalg.norm(edge))
        outward = complex(edge[1], -edge[0]) / length
        steps = (np.arange(round(length)) + 0.5) / max(1, round(length))
        pixels = np.rint(start + steps[:, None] * edge).astype(int)[:, ::-1] % template.shape
        np.add.at(template, tuple(pixels.T), outward)
        count += len(steps)
    correlation = fft.ifft2(spectrum * np.conj(fft.fft2(template))).real
    scores = correlation[: shape[0], : shape[1]] / count
    low, high = np.ceil(-corners.min(axis=0)), np.floor(corners.max(axis=0))
    rows, columns = np.ogrid[: shape[0], : shape[1]]
    across = (columns >= low[0]) & (columns < shape[1] - high[0])
    return np.where(across & (rows >= low[1]) & (rows < shape[0] - high[1]), scores, 0.0)

"""Centers of all contacts at once, from a map that is linear in its coefficients.

Centers that share an offset are consistent with a map of another offset, which no alternation of
fitting map and centers removes. The slopes along a line have a mean of zero if the face is flat at
both ends, which determines the offset. Map and centers are fitted together: slopes are linear in
the coefficients of a polynomial of the colors, and in small shifts of the centers.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from tactorch.sensor.calibration.ball import Ball, BallPress, Circle

_ROUNDS = 15
_INSIDE = 0.8  # of the contact's radius, of pixels with the ball's slopes
_FLAT = 2.2  # radii beyond which the face is flat
_LINES, _LINE_SPAN = 25, 1.3  # number of lines in each direction, and their largest offset, radii
_PIXELS, _FLAT_PIXELS = 800, 400  # drawn per press
_LINE_WEIGHT = 300.0  # of the mean slope of a line, relative to a pixel's slope
_RIDGE = 1e-4
_SHIFT_WEIGHT = 0.06  # of a shift over the contact's radius, squared
_MAX_SHIFT = 0.15  # in a round, over the contact's radius
_MARGIN = 0.03  # of the image's size, by which a line may leave the image
_STEP_PX = 0.5

Rows = Float[np.ndarray, "_ terms"]


@dataclass(frozen=True, eq=False)
class _Samples:
    """Rows of the least-squares problem of a press, and its slopes and their derivatives."""

    inside: Rows
    flat: Rows
    lines: tuple[Rows, Rows]  # along x, along y
    slopes: Float[np.ndarray, "n 2"]
    by_center: Float[np.ndarray, "n 2 2"]  # slope component, center component


def align_contacts(
    presses: Sequence[BallPress], ball: Ball, contacts_mm: Sequence[float], seed: int = 0
) -> list[BallPress]:
    """Return presses with fitted centers; those of labeled presses are kept.

    `contacts_mm` are approximate radii of the contacts; the seed is that of the drawn pixels.
    """
    rng = np.random.default_rng(seed)
    start = np.array([press.contact.center_px for press in presses])
    centers, free = start.copy(), np.array([not press.labeled for press in presses])
    if not free.any():
        return list(presses)
    size = np.array(contacts_mm)[:, None] / np.array(ball.mm_per_px)  # radii along x and y, px
    for _ in range(_ROUNDS):
        samples = [
            _draw_samples(press, ball, tuple(center.tolist()), radius, rng)
            for press, center, radius in zip(presses, centers, contacts_mm, strict=True)
        ]
        shift = _solve_shifts(samples, centers - start, size) * free[:, None]
        length = np.linalg.norm(shift / size, axis=1, keepdims=True)
        centers = centers + shift * np.minimum(1.0, _MAX_SHIFT / np.maximum(length, 1e-12))
    rows, columns = presses[0].shape
    centers = np.clip(centers, 0.0, [columns - 1.0, rows - 1.0])
    return [
        replace(press, fitted=Circle((float(x), float(y)), max(2.0, float(radius))))
        for press, (x, y), radius in zip(presses, centers, size[:, 0], strict=True)
    ]


def _solve_shifts(
    samples: Sequence[_Samples],
    shifted: Float[np.ndarray, "presses 2"],
    size: Float[np.ndarray, "presses 2"],
) -> Float[np.ndarray, "presses 2"]:
    """Solve for the coefficients of the map and for shifts of the centers, px."""
    terms, count = samples[0].inside.shape[1], len(samples)
    normal = np.zeros((2 * terms + 2 * count,) * 2)
    right = np.zeros(len(normal))
    for press, each in enumerate(samples):
        number = max(len(each.inside), 1)
        at = slice(2 * terms + 2 * press, 2 * terms + 2 * press + 2)
        for axis in range(2):
            block = slice(axis * terms, (axis + 1) * terms)
            by_center, lines = each.by_center[:, axis], each.lines[axis]
            normal[block, block] += each.inside.T @ each.inside / number
            normal[block, block] += each.flat.T @ each.flat / max(len(each.flat), 1)
            normal[block, block] += _LINE_WEIGHT * lines.T @ lines / max(len(lines), 1)
            normal[block, at] -= each.inside.T @ by_center / number
            normal[at, at] += by_center.T @ by_center / number
            right[block] += each.inside.T @ each.slopes[:, axis] / number
            right[at] -= by_center.T @ each.slopes[:, axis] / number
        normal[at, : 2 * terms] = normal[: 2 * terms, at].T
        weight = _SHIFT_WEIGHT / size[press] ** 2
        normal[at, at] += np.diag(weight)
        right[at] -= weight * shifted[press]
    normal[: 2 * terms, : 2 * terms] += _RIDGE * np.eye(2 * terms)
    return np.linalg.solve(normal, right)[2 * terms :].reshape(count, 2)


def _draw_samples(
    press: BallPress,
    ball: Ball,
    center: tuple[float, float],
    radius_mm: float,
    rng: np.random.Generator,
) -> _Samples:
    distance = np.hypot(*ball.offsets(press.shape, Circle(center, 2.0)))
    near, far = distance < _INSIDE * radius_mm, distance > _FLAT * radius_mm
    inside = draw(rng, np.flatnonzero(press.known & near), _PIXELS)
    flat = draw(rng, np.flatnonzero(press.known & far), _FLAT_PIXELS)
    rows, columns = np.unravel_index(inside, press.shape)

    def slopes(x: float, y: float) -> np.ndarray:
        return ball.slopes_at(ball.offsets_at(columns, rows, (x, y)))

    (x, y), at = center, slopes(*center)
    along = [slopes(x + _STEP_PX, y) - at, slopes(x, y + _STEP_PX) - at]
    by_center = np.stack(along, axis=-1) / _STEP_PX
    lines = [_line_means(press, ball, center, radius_mm, axis) for axis in range(2)]
    colors = press.change.reshape(-1, 3)
    terms = _terms(colors[inside]), _terms(colors[flat])
    return _Samples(*terms, (lines[0], lines[1]), at, by_center)


def _line_means(
    press: BallPress, ball: Ball, center: tuple[float, float], radius_mm: float, axis: int
) -> Rows:
    """Mean terms along lines through the contact that end in flat parts of the face."""
    columns_first = press.change.transpose(1, 0, 2) if axis == 0 else press.change
    length, width = columns_first.shape[:2]  # along the line, across it
    reach = _FLAT * radius_mm / ball.mm_per_px[axis]
    low, high = center[axis] - reach, center[axis] + reach
    if low < -_MARGIN * length or high > (1 + _MARGIN) * length:
        return np.zeros((0, _terms(press.change[0]).shape[1]))
    along = np.arange(max(0, round(low)), min(length, round(high)))
    offsets = np.linspace(-_LINE_SPAN, _LINE_SPAN, _LINES) * radius_mm / ball.mm_per_px[1 - axis]
    across = np.unique(np.clip(np.round(center[1 - axis] + offsets), 0, width - 1).astype(int))
    lines = columns_first[along][:, across]
    return _terms(lines.reshape(-1, 3)).reshape(len(along), len(across), -1).mean(axis=0)


def _terms(colors: Float[np.ndarray, "n 3"]) -> Rows:
    """Colors and their products: no change has no slope."""
    a, b = np.triu_indices(3)
    return np.concatenate([colors, colors[:, a] * colors[:, b]], axis=1)


def draw(rng: np.random.Generator, pixels: np.ndarray, count: int) -> np.ndarray:
    """Draw a number of pixels, or all where there are fewer."""
    return rng.choice(pixels, min(count, len(pixels)), replace=False)

"""How well a map sees slopes that it was not fitted to."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tactorch.sensor.calibration.ball import Ball, Circle
from tactorch.sensor.calibration.fit import Touch, seen_slopes
from tactorch.sensor.calibration.maps import SlopeMap
from tactorch.sensor.depth import integrate

_INSIDE = 0.9  # of a contact's radius: judged


@dataclass(frozen=True)
class Quality:
    """Errors inside the contacts of some presses.

    Attributes:
        r2: Share of the slopes' variance that is explained, along x and y.
        mae: Mean absolute error of the slopes, along x and y.
        depth_rms_mm: Root mean square error of the ball's height, but for a constant, mm.
        pixels: Number of pixels judged.
    """

    r2: tuple[float, float]
    mae: tuple[float, float]
    depth_rms_mm: float
    pixels: int


def judge(
    found: SlopeMap, touches: Sequence[Touch], circles: Sequence[Circle], ball: Ball
) -> Quality:
    """Compare what a map sees of presses with the ball.

    Args:
        found: The map.
        touches: Presses.
        circles: Where the ball touches in each.
        ball: The ball.
    """
    pairs = [_pair(found, t, c, ball) for t, c in zip(touches, circles, strict=True)]
    seen, true = (np.concatenate([pair[k] for pair in pairs]) for k in (0, 1))
    depths = [_depth_off(found, t, c, ball) for t, c in zip(touches, circles, strict=True)]
    left = ((seen - true) ** 2).sum(axis=0) / ((true - true.mean(axis=0)) ** 2).sum(axis=0)
    mae = np.abs(seen - true).mean(axis=0)
    return Quality(
        (float(1 - left[0]), float(1 - left[1])),
        (float(mae[0]), float(mae[1])),
        float(np.sqrt(np.mean(np.concatenate(depths) ** 2))),
        len(seen),
    )


def _pair(
    found: SlopeMap, touch: Touch, circle: Circle, ball: Ball
) -> tuple[Float[np.ndarray, "p 2"], Float[np.ndarray, "p 2"]]:
    shape = touch.changed.shape[:2]
    inside = touch.known & (ball.distance(shape, circle) < _INSIDE)
    return seen_slopes(found, touch.changed)[inside], ball.slopes(shape, circle)[inside]


def _depth_off(
    found: SlopeMap, touch: Touch, circle: Circle, ball: Ball
) -> Float[np.ndarray, " p"]:
    shape = touch.changed.shape[:2]
    slopes = seen_slopes(found, touch.changed)
    height = integrate(slopes[..., 0], slopes[..., 1], ball.mm_per_px)
    inside = ball.distance(shape, circle) < _INSIDE
    off = (height - ball.heights(shape, circle))[inside]
    return off - off.mean()

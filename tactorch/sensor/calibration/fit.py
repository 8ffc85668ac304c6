"""From presses of a ball to a calibration: circles and the map from colours are found together.

A circle that is a pixel or two off makes slopes that no map of colours can meet, and hand labels
and blob finders are off by as much. So map and circles are fitted in turn: the map to the slopes
that the circles tell, each circle to the slopes that the map sees. The mean of all offsets stays
where it is, for no change of colour means no slope. The ball's size in pixels is not found in this
way: slopes of a larger ball are as good a function of the colours. It has to be measured
(`mm_per_px`).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import minimize

from tactorch.errors import ConfigError
from tactorch.sensor.calibration.ball import Ball, Circle
from tactorch.sensor.calibration.change import features
from tactorch.sensor.calibration.maps import SlopeMap, make_map

_INSIDE = 0.92  # of a contact's radius: learnt from
_MIDDLE = 0.8  # of it: what a circle is fitted to
_FAR = 2.2  # of it: nothing is touched there
_PIXELS, _FAR_PIXELS = 2500, 600  # of each press
_OUTLIER = 0.25  # squared difference of slopes above which a pixel counts no more
_AGREES = 0.85  # of the ball's slope: where the seen one falls below, contact ends
# A map that has not learnt steep slopes sees none, and takes contact to end where it does: were
# circles free to shrink they would do so round by round, and leave out what is hard to see.
_LEAST = 0.9  # of a contact's radius as found or labelled


@dataclass(frozen=True, eq=False)
class Touch:
    """A press of the ball as it is learnt from.

    Attributes:
        name: Of the image.
        changed: Change of the colours, see `change`.
        known: Pixels that no marker covers.
        circle: Where the ball touches, as far as is known.
    """

    name: str
    changed: Float[np.ndarray, "h w 3"]
    known: Bool[np.ndarray, "h w"]
    circle: Circle

    def __post_init__(self) -> None:
        rows, columns = self.changed.shape[:2]
        (x, y), radius = self.circle.center_px, self.circle.radius_px
        if not (-0.5 <= x <= columns - 0.5 and -0.5 <= y <= rows - 0.5):
            raise ConfigError(
                f"{self.name}: the contact at ({x:g}, {y:g}) px lies beside the image of {columns}"
                f" x {rows} px; are labels and image of one size, and x before y?"
            )
        if radius > max(rows, columns):
            raise ConfigError(
                f"{self.name}: the contact's radius_px={radius:g} is more than the image of"
                f" {columns} x {rows} px; give pixels."
            )
        if not np.isfinite(self.changed).all():
            raise ConfigError(
                f"{self.name}: the change of its colours is not finite; leave it out."
            )


@dataclass(frozen=True)
class FitOptions:
    """How a calibration is found.

    Attributes:
        map: One of `MAPS`.
        rounds: Of map and circles in turn; 0 takes circles as they are.
        seed: Of the network and of the pixels drawn.
    """

    map: str = "mlp"
    rounds: int = 6
    seed: int = 0

    def __post_init__(self) -> None:
        if self.rounds < 0 or self.seed < 0:
            raise ConfigError(f"rounds={self.rounds}, seed={self.seed} must not be negative.")
        make_map(self.map)


def fit_map(
    touches: Sequence[Touch],
    ball: Ball,
    options: FitOptions | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[SlopeMap, Mapping[str, Circle]]:
    """Return the map from colours to slopes, and the circles found with it.

    Args:
        touches: Presses to learn from.
        ball: What was pressed.
        options: How to.
        progress: Called with the rounds done and their number.

    Raises:
        ConfigError: There are no presses, or a contact is wider than the ball.
    """
    options = options or FitOptions()
    if not touches:
        raise ConfigError(
            "no press of the ball to calibrate with; give images and where it touches."
        )
    found = make_map(options.map, options.seed)
    circles = [touch.circle for touch in touches]
    for number in range(options.rounds):
        _learn(found, touches, circles, ball, options.seed + number)
        circles = [
            fit_circle(touch, found, ball, circle)
            for touch, circle in zip(touches, circles, strict=True)
        ]
        if progress is not None:
            progress(number + 1, options.rounds + 1)
    _learn(found, touches, circles, ball, options.seed + options.rounds)
    if progress is not None:
        progress(options.rounds + 1, options.rounds + 1)
    return found, {t.name: c for t, c in zip(touches, circles, strict=True)}


def seen_slopes(found: SlopeMap, changed: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "h w 2"]:
    """Return the slopes that a map sees in an image."""
    rows = features(changed).reshape(-1, 5)
    return found(rows).reshape(*changed.shape[:2], 2)


def fit_circle(touch: Touch, found: SlopeMap, ball: Ball, circle: Circle) -> Circle:
    """Return the circle whose ball has the slopes that a map sees, best.

    The middle is fitted to the slopes well inside; the radius is where the seen slope, going out
    from it, falls behind the ball's, and at least 0.9 of that of the touch.
    """
    slopes = seen_slopes(found, touch.changed)
    shape = touch.changed.shape[:2]
    inside = touch.known & (ball.distance(shape, circle) < _MIDDLE)
    rows, columns = np.nonzero(inside)
    if len(rows) < 20:
        raise ConfigError(f"{touch.name}: fewer than 20 pixels of the contact are not markers.")
    own = slopes[inside]

    def off(center: Float[np.ndarray, "2"]) -> float:
        x = (columns - center[0]) * ball.mm_per_px[0]
        y = (rows - center[1]) * ball.mm_per_px[1]
        below = np.sqrt(np.maximum(ball.radius_mm**2 - x**2 - y**2, (0.2 * ball.radius_mm) ** 2))
        difference = own - np.stack([x, y], axis=-1) / below[:, None]
        return float(np.minimum((difference**2).sum(axis=1), _OUTLIER).mean())

    start = np.array(circle.center_px)
    corners = start + np.array([(0.0, 0.0), (2.0, 0.0), (0.0, 2.0)])
    best = minimize(
        off, start, method="Nelder-Mead",
        options={"xatol": 0.05, "fatol": 1e-6, "initial_simplex": corners},
    ).x  # fmt: skip
    middle = Circle((float(best[0]), float(best[1])), circle.radius_px)
    radius = _radius(slopes, touch.known, ball, middle)
    return Circle(middle.center_px, max(radius, _LEAST * touch.circle.radius_px))


def _radius(
    slopes: Float[np.ndarray, "h w 2"], known: Bool[np.ndarray, "h w"], ball: Ball, circle: Circle
) -> float:
    """Where the slope away from the middle falls behind the ball's, in pixels."""
    x, y = ball.away(known.shape, circle)
    distance = np.hypot(x, y)
    outward = (slopes[..., 0] * x + slopes[..., 1] * y) / np.maximum(distance, 1e-9)
    width = ball.mm_per_px[0]
    rings = (distance / width).astype(int)
    most = int(ball.radius_mm / width)
    least = max(3, round(0.3 * most))
    for ring in range(least, most):
        own = outward[known & (rings == ring)]
        middle = (ring + 0.5) * width
        true = middle / np.sqrt(max(ball.radius_mm**2 - middle**2, 1e-9))
        if len(own) and np.median(own) < _AGREES * true:
            return float(ring)
    return float(most)


def _learn(
    found: SlopeMap, touches: Sequence[Touch], circles: Sequence[Circle], ball: Ball, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    seen, slopes = [], []
    for touch, circle in zip(touches, circles, strict=True):
        ball.check(circle, touch.name)
        shape = touch.changed.shape[:2]
        rows = features(touch.changed).reshape(-1, 5)
        distance = np.where(touch.known, ball.distance(shape, circle), np.nan).ravel()
        inside = _some(rng, np.flatnonzero(distance < _INSIDE), _PIXELS)
        if not len(inside):
            raise ConfigError(f"{touch.name}: no pixel of the contact is not a marker's.")
        seen.append(rows[inside])
        slopes.append(ball.slopes(shape, circle).reshape(-1, 2)[inside])
        # Where nothing is touched nothing is sloped; its colours do not change but for noise.
        far = _some(rng, np.flatnonzero(distance > _FAR), _FAR_PIXELS)
        still = rows[far].copy()
        still[:, :3] = rng.normal(0.0, 0.02, (len(far), 3))
        seen.append(still)
        slopes.append(np.zeros((len(far), 2)))
    found.fit(np.concatenate(seen), np.concatenate(slopes), seed)


def _some(rng: np.random.Generator, places: np.ndarray, most: int) -> np.ndarray:
    return rng.choice(places, min(most, len(places)), replace=False)

"""Joint fit of the map from colors to slopes and of the contacts of a ball.

Labels and detected contacts are off by some pixels, which makes slopes inconsistent with any map.
Map and contacts are therefore fitted alternately: the map to the slopes of the contacts, each
contact to the slopes of the map. The mean offset of the contacts is determined because no change of
color means no slope. The size of a pixel is not: slopes of a larger ball are an equally good
function of the colors, so `mm_per_px` has to be measured.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import minimize

from tactorch.config import Options, option
from tactorch.errors import ConfigError
from tactorch.sensor.calibration.ball import Ball, BallPress, Circle
from tactorch.sensor.calibration.features import pixel_features
from tactorch.sensor.calibration.maps import Mlp, SensorMap, SlopeMap, map_slopes

_TRAINING_RADIUS = 0.92  # of the pixels that the map is fitted to, over the contact's radius
_CENTER_RADIUS = 0.8  # of the pixels that a circle's center is fitted to
_FREE_RADIUS = 2.2  # beyond which the gel is not in contact
_PIXELS, _FREE_PIXELS = 2500, 600  # drawn per press
_MAX_SQUARED_ERROR = 0.25  # of slopes, for pixels that count as outliers
_SLOPE_FRACTION = 0.85  # of the ball's slope, below which the contact ends
# A map not yet fitted to steep slopes underestimates them. Without this limit circles would shrink
# from round to round and exclude steep pixels.
_MIN_RADIUS = 0.9  # of a fitted contact, over its labeled or detected radius


@dataclass(frozen=True)
class FitOptions(Options):
    """Calibration fit."""

    map: SensorMap = option(factory=Mlp, help="Map from colors to slopes", section="sensor_map")
    rounds: int = option(6, "Alternations of fitting map and contacts; 0 keeps the contacts", ge=0)
    seed: int = option(0, "Seed of the map and of the drawn pixels", ge=0)


def fit_map(
    presses: Sequence[BallPress],
    ball: Ball,
    options: FitOptions | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[SlopeMap, Mapping[str, Circle]]:
    """Fit the map from colors to slopes together with the contacts.

    Args:
        presses: Presses of the ball.
        ball: Ball.
        options: Fit options.
        progress: Callback with the number of finished rounds and of all.

    Returns:
        The map, and the fitted contact of each press by name.

    Raises:
        ConfigError: There are no presses, or a contact is wider than the ball.
    """
    options = options or FitOptions()
    if not presses:
        raise ConfigError(
            "no press of the ball to calibrate with; give images and where it touches."
        )
    slope_map = options.map.create(options.seed)
    circles = [press.circle for press in presses]
    for number in range(options.rounds + 1):
        _fit_map_to_circles(slope_map, presses, circles, ball, options.seed + number)
        if number < options.rounds:
            circles = [
                fit_circle(press, slope_map, ball, circle)
                for press, circle in zip(presses, circles, strict=True)
            ]
        if progress is not None:
            progress(number + 1, options.rounds + 1)
    return slope_map, {p.name: c for p, c in zip(presses, circles, strict=True)}


def fit_circle(press: BallPress, slope_map: SlopeMap, ball: Ball, circle: Circle) -> Circle:
    """Fit a contact to the slopes of a map.

    The center is fitted to the slopes well inside. The radius is where the slope of the map falls
    below that of the ball, and at least 0.9 of the press's labeled or detected radius.

    Args:
        press: Press.
        slope_map: Map from colors to slopes.
        ball: Ball.
        circle: Start.

    Returns:
        The contact.

    Raises:
        ConfigError: Markers cover the contact.
    """
    slopes = map_slopes(slope_map, press.change)
    inside = press.known & (ball.distance(press.shape, circle) < _CENTER_RADIUS)
    rows, columns = np.nonzero(inside)
    if len(rows) < 20:
        raise ConfigError(
            f"{press.name}: fewer than 20 pixels of the contact are not markers; leave it out."
        )
    measured = slopes[inside]

    def misfit(center: Float[np.ndarray, "2"]) -> float:
        x = (columns - center[0]) * ball.mm_per_px[0]
        y = (rows - center[1]) * ball.mm_per_px[1]
        below = np.sqrt(np.maximum(ball.radius_mm**2 - x**2 - y**2, (0.2 * ball.radius_mm) ** 2))
        error = measured - np.stack([x, y], axis=-1) / below[:, None]
        return float(np.minimum((error**2).sum(axis=1), _MAX_SQUARED_ERROR).mean())

    start = np.array(circle.center_px)
    simplex = start + np.array([(0.0, 0.0), (2.0, 0.0), (0.0, 2.0)])
    best = minimize(
        misfit, start, method="Nelder-Mead",
        options={"xatol": 0.05, "fatol": 1e-6, "initial_simplex": simplex},
    ).x  # fmt: skip
    centered = Circle((float(best[0]), float(best[1])), circle.radius_px)
    radius = _contact_radius(slopes, press.known, ball, centered)
    return Circle(centered.center_px, max(radius, _MIN_RADIUS * press.circle.radius_px))


def _contact_radius(
    slopes: Float[np.ndarray, "h w 2"], known: Bool[np.ndarray, "h w"], ball: Ball, circle: Circle
) -> float:
    """Radius at which the outward slope falls below the ball's, pixels."""
    x, y = ball.offsets(known.shape, circle)
    distance = np.hypot(x, y)
    outward = (slopes[..., 0] * x + slopes[..., 1] * y) / np.maximum(distance, 1e-9)
    width = ball.mm_per_px[0]
    ring_index = (distance / width).astype(int)
    max_ring = int(ball.radius_mm / width)
    for ring in range(max(3, round(0.3 * max_ring)), max_ring):
        values = outward[known & (ring_index == ring)]
        radius = (ring + 0.5) * width
        expected = radius / np.sqrt(max(ball.radius_mm**2 - radius**2, 1e-9))
        if len(values) and np.median(values) < _SLOPE_FRACTION * expected:
            return float(ring)
    return float(max_ring)


def _fit_map_to_circles(
    slope_map: SlopeMap,
    presses: Sequence[BallPress],
    circles: Sequence[Circle],
    ball: Ball,
    seed: int,
) -> None:
    rng = np.random.default_rng(seed)
    features, slopes = [], []
    for press, circle in zip(presses, circles, strict=True):
        ball.check(circle, press.name)
        rows = pixel_features(press.change)
        distance = np.where(press.known, ball.distance(press.shape, circle), np.nan).ravel()
        inside = _draw(rng, np.flatnonzero(distance < _TRAINING_RADIUS), _PIXELS)
        if not len(inside):
            raise ConfigError(f"{press.name}: markers cover the whole contact; leave it out.")
        features.append(rows[inside])
        slopes.append(ball.slopes(press.shape, circle).reshape(-1, 2)[inside])
        # Pixels without contact have zero slope and no change of color but noise.
        free = _draw(rng, np.flatnonzero(distance > _FREE_RADIUS), _FREE_PIXELS)
        unchanged = rows[free].copy()
        unchanged[:, :3] = rng.normal(0.0, 0.02, (len(free), 3))
        features.append(unchanged)
        slopes.append(np.zeros((len(free), 2)))
    slope_map.fit(np.concatenate(features), np.concatenate(slopes), seed)


def _draw(rng: np.random.Generator, pixels: np.ndarray, count: int) -> np.ndarray:
    return rng.choice(pixels, min(count, len(pixels)), replace=False)

"""Joint fit of the map from colors to slopes and of the contacts of a ball, and its accuracy.

Labels and detected contacts are off by some pixels, which makes slopes inconsistent with any map.
Map and contacts are therefore fitted alternately: the map to the slopes of the contacts, each
contact to the slopes of the map. The mean offset of the contacts is determined because no change of
color means no slope. The size of a pixel is not: slopes of a larger ball are an equally good
function of the colors, so `mm_per_px` has to be measured.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize

from tactorch.config import Options, option
from tactorch.errors import ConfigError
from tactorch.sensor.calibration.ball import Ball, BallPress, Circle
from tactorch.sensor.calibration.maps import (
    SENSOR_MAPS,
    Mlp,
    SensorMap,
    SlopeMap,
    map_slopes,
    pixel_features,
)
from tactorch.sensor.depth import integrate_slopes

_TRAINING_RADIUS = 0.92  # of the pixels that the map is fitted to, over the contact's radius
_CENTER_RADIUS = 0.8  # of the pixels that a circle's center is fitted to
_EVALUATED_RADIUS = 0.9  # of the pixels that the map is evaluated at
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
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[SlopeMap, list[BallPress]]:
    """Fit the map from colors to slopes together with the contacts.

    Args:
        presses: Presses of the ball.
        ball: Ball, and the size of a pixel.
        options: Fit options.
        progress: Callback with the number of finished rounds and of all.

    Returns:
        The map, and the presses with fitted contacts.
    """
    options = options or FitOptions()
    if not presses:
        raise ConfigError(
            "no press of the ball to calibrate with; give images and where it touches."
        )
    slope_map, fitted = options.map.create(options.seed), list(presses)
    for number in range(options.rounds + 1):
        _fit_map_to_contacts(slope_map, fitted, ball, options.seed + number)
        if number < options.rounds:
            fitted = [fit_contact(press, slope_map, ball) for press in fitted]
        progress(number + 1, options.rounds + 1)
    return slope_map, fitted


def fit_contact(press: BallPress, slope_map: SlopeMap, ball: Ball) -> BallPress:
    """Return a press with its contact fitted to the slopes of a map, from the present contact.

    The center is fitted to the slopes well inside. The radius is where the slope of the map falls
    below that of the ball, and at least 0.9 of the press's labeled or detected radius.

    Raises:
        ConfigError: Markers cover the contact.
    """
    slopes, circle = map_slopes(slope_map, press.change), press.contact
    inside = press.known & (ball.distance(press.shape, circle) < _CENTER_RADIUS)
    rows, columns = np.nonzero(inside)
    if len(rows) < 20:
        raise ConfigError(
            f"{press.name}: fewer than 20 pixels of the contact are not markers; leave it out."
        )
    measured = slopes[inside]

    def misfit(center: np.ndarray) -> float:
        error = measured - ball.slopes_at(ball.offsets_at(columns, rows, center))
        return float(np.minimum((error**2).sum(axis=1), _MAX_SQUARED_ERROR).mean())

    start = np.array(circle.center_px)
    simplex = start + np.array([(0.0, 0.0), (2.0, 0.0), (0.0, 2.0)])
    x, y = minimize(
        misfit, start, method="Nelder-Mead",
        options={"xatol": 0.05, "fatol": 1e-6, "initial_simplex": simplex},
    ).x  # fmt: skip
    radius = _contact_radius(slopes, press, ball, Circle((x, y), circle.radius_px))
    radius = max(radius, _MIN_RADIUS * press.circle.radius_px)
    return replace(press, fitted=Circle((x, y), radius))


def fit_new_contact(press: BallPress, slope_map: SlopeMap, ball: Ball) -> BallPress:
    """Fit the contact of a left-out press in two passes, since the first changes the radius."""
    return fit_contact(fit_contact(press, slope_map, ball), slope_map, ball)


def _contact_radius(slopes: np.ndarray, press: BallPress, ball: Ball, circle: Circle) -> float:
    """Radius at which the outward slope falls below the ball's, pixels."""
    x, y = ball.offsets(press.shape, circle)
    distance = np.hypot(x, y)
    outward = (slopes[..., 0] * x + slopes[..., 1] * y) / np.maximum(distance, 1e-9)
    width = ball.mm_per_px[0]
    ring_index = (distance / width).astype(int)
    max_ring = int(ball.radius_mm / width)
    for ring in range(max(3, round(0.3 * max_ring)), max_ring):
        values = outward[press.known & (ring_index == ring)]
        radius = (ring + 0.5) * width
        expected = radius / np.sqrt(max(ball.radius_mm**2 - radius**2, 1e-9))
        if len(values) and np.median(values) < _SLOPE_FRACTION * expected:
            return float(ring)
    return float(max_ring)


def _fit_map_to_contacts(
    slope_map: SlopeMap, presses: Sequence[BallPress], ball: Ball, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    features, slopes = [], []
    for press in presses:
        circle = press.contact
        ball.check(circle, press.name)
        rows = pixel_features(press.change)
        distance = np.where(press.known, ball.distance(press.shape, circle), np.nan).ravel()
        inside = _draw(rng, np.flatnonzero(distance < _TRAINING_RADIUS), _PIXELS)
        if not len(inside):
            raise ConfigError(f"{press.name}: markers cover the whole contact; leave it out.")
        # Pixels without contact have zero slope and no change of color but noise.
        free = _draw(rng, np.flatnonzero(distance > _FREE_RADIUS), _FREE_PIXELS)
        unchanged = rows[free]
        unchanged[:, :3] = rng.normal(0.0, 0.02, (len(free), 3))
        features += [rows[inside], unchanged]
        slopes += [
            ball.slopes(press.shape, circle).reshape(-1, 2)[inside], np.zeros((len(free), 2))
        ]  # fmt: skip
    slope_map.fit(np.concatenate(features), np.concatenate(slopes), seed)


def _draw(rng: np.random.Generator, pixels: np.ndarray, count: int) -> np.ndarray:
    return rng.choice(pixels, min(count, len(pixels)), replace=False)


@dataclass(frozen=True)
class MapQuality:
    """Errors inside the contacts of presses.

    Attributes:
        r2: Coefficient of determination of the slopes along x and y.
        mae: Mean absolute error of the slopes along x and y.
        depth_rms_mm: Root mean square error of the ball's height up to a constant, mm.
        pixels: Number of evaluated pixels.
    """

    r2: tuple[float, float]
    mae: tuple[float, float]
    depth_rms_mm: float
    pixels: int

    @classmethod
    def pool(cls, parts: "Sequence[MapQuality]") -> "MapQuality":
        """Return the errors of groups of presses, weighted by their pixels."""
        counts = [part.pixels for part in parts]
        r2 = np.average([part.r2 for part in parts], axis=0, weights=counts)
        mae = np.average([part.mae for part in parts], axis=0, weights=counts)
        squares = np.average([part.depth_rms_mm**2 for part in parts], weights=counts)
        depth = float(np.sqrt(squares))
        return cls(tuple(r2.tolist()), tuple(mae.tolist()), depth, sum(counts))


def evaluate_map(slope_map: SlopeMap, presses: Sequence[BallPress], ball: Ball) -> MapQuality:
    """Return the errors of the slopes and heights of a map for all presses together.

    They are compared with those of the ball at the contacts of the presses.
    """
    results = [_compare(slope_map, press, ball) for press in presses]
    slopes, expected, heights = (np.concatenate(parts) for parts in zip(*results, strict=True))
    spread = ((expected - expected.mean(axis=0)) ** 2).sum(axis=0)
    r2 = 1 - ((slopes - expected) ** 2).sum(axis=0) / spread
    mae = np.abs(slopes - expected).mean(axis=0)
    depth = float(np.sqrt(np.mean(heights**2)))
    return MapQuality(tuple(r2.tolist()), tuple(mae.tolist()), depth, len(slopes))


def _compare(slope_map: SlopeMap, press: BallPress, ball: Ball) -> tuple[np.ndarray, ...]:
    """Slopes of the map and of the ball, and errors of the height."""
    slopes, circle = map_slopes(slope_map, press.change), press.contact
    contact = ball.distance(press.shape, circle) < _EVALUATED_RADIUS
    inside = press.known & contact
    height = integrate_slopes(slopes[..., 0], slopes[..., 1], ball.mm_per_px)
    error = (height - ball.heights(press.shape, circle))[contact]
    return slopes[inside], ball.slopes(press.shape, circle)[inside], error - error.mean()


def validation_groups(
    presses: Sequence[BallPress], ball: Ball, options: FitOptions, folds: int
) -> Iterator[tuple[SlopeMap, list[BallPress]]]:
    """Yield for each group the map fitted to all other presses, and the group.

    The contacts of left-out presses are fitted: three parameters to thousands of pixels.
    """
    if not 2 <= folds <= len(presses):
        raise ConfigError(f"folds={folds}: give 2 to {len(presses)}, the number of presses.")
    order = np.random.default_rng(options.seed).permutation(len(presses))
    for fold in range(folds):
        group = set(order[fold::folds].tolist())
        training = [press for i, press in enumerate(presses) if i not in group]
        left_out = [press for i, press in enumerate(presses) if i in group]
        slope_map, _ = fit_map(training, ball, options)
        yield slope_map, [fit_new_contact(press, slope_map, ball) for press in left_out]


def cross_validate(
    presses: Sequence[BallPress], ball: Ball, options: FitOptions | None = None, folds: int = 3
) -> MapQuality:
    """Return the errors on presses that are left out of the fit, each once, pooled over the groups.

    Arguments are those of `fit_map`; the seed of the options also assigns presses to the `folds`
    groups.
    """
    groups = validation_groups(presses, ball, options or FitOptions(), folds)
    return MapQuality.pool([evaluate_map(*group, ball) for group in groups])


def select_map(
    presses: Sequence[BallPress],
    ball: Ball,
    options: FitOptions | None = None,
    folds: int = 3,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[str, dict[str, MapQuality]]:
    """Select the map with the smallest error on left-out presses.

    Arguments are those of `cross_validate`, and a callback with the number of evaluated maps and of
    all. `map` of the options is ignored.

    Returns:
        The name of the map, and the errors of each by name.
    """
    options, names = options or FitOptions(), SENSOR_MAPS.names()
    quality = {}
    for number, name in enumerate(names):
        candidate = replace(options, map=SENSOR_MAPS.build(name))
        quality[name] = cross_validate(presses, ball, candidate, folds)
        progress(number + 1, len(names))
    return min(quality, key=lambda name: sum(quality[name].mae)), quality

"""Accuracy of maps on presses that they were not fitted to, and selection among maps."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.sensor.calibration.ball import Ball, BallPress, Circle
from tactorch.sensor.calibration.fit import FitOptions, fit_circle, fit_map
from tactorch.sensor.calibration.maps import SENSOR_MAPS, SlopeMap, map_slopes
from tactorch.sensor.depth import integrate_slopes

_EVALUATED_RADIUS = 0.9  # of the evaluated pixels, over the contact's radius


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


def evaluate_map(
    slope_map: SlopeMap, presses: Sequence[BallPress], circles: Sequence[Circle], ball: Ball
) -> MapQuality:
    """Compare the slopes and heights of a map with those of the ball.

    Args:
        slope_map: Map.
        presses: Presses.
        circles: Contact of each press.
        ball: Ball.

    Returns:
        The errors of all presses together.
    """
    errors = [_press_errors(slope_map, p, c, ball) for p, c in zip(presses, circles, strict=True)]
    slopes, expected, heights = (np.concatenate([e[k] for e in errors]) for k in range(3))
    spread = ((expected - expected.mean(axis=0)) ** 2).sum(axis=0)
    unexplained = ((slopes - expected) ** 2).sum(axis=0) / spread
    mae = np.abs(slopes - expected).mean(axis=0)
    return MapQuality(
        (float(1 - unexplained[0]), float(1 - unexplained[1])),
        (float(mae[0]), float(mae[1])),
        float(np.sqrt(np.mean(heights**2))),
        len(slopes),
    )


def _press_errors(
    slope_map: SlopeMap, press: BallPress, circle: Circle, ball: Ball
) -> tuple[Float[np.ndarray, "p 2"], Float[np.ndarray, "p 2"], Float[np.ndarray, " q"]]:
    """Slopes of the map and of the ball, and errors of the height."""
    slopes = map_slopes(slope_map, press.change)
    contact = ball.distance(press.shape, circle) < _EVALUATED_RADIUS
    inside = press.known & contact
    height = integrate_slopes(slopes[..., 0], slopes[..., 1], ball.mm_per_px)
    error = (height - ball.heights(press.shape, circle))[contact]
    return slopes[inside], ball.slopes(press.shape, circle)[inside], error - error.mean()


def cross_validate(
    presses: Sequence[BallPress], ball: Ball, options: FitOptions | None = None, folds: int = 3
) -> MapQuality:
    """Return the errors on presses that are left out of the fit, each once.

    The contacts of left-out presses are fitted: three parameters to thousands of pixels.

    Args:
        presses: Presses.
        ball: Ball.
        options: Fit options.
        folds: Number of groups.

    Returns:
        The errors, pooled over the groups.

    Raises:
        ConfigError: There are fewer presses than folds, or fewer than two folds.
    """
    groups = validation_groups(presses, ball, options or FitOptions(), folds)
    return pool_quality(
        [evaluate_map(m, left_out, circles, ball) for m, left_out, circles in groups]
    )


def validation_groups(
    presses: Sequence[BallPress], ball: Ball, options: FitOptions, folds: int
) -> Iterator[tuple[SlopeMap, list[BallPress], list[Circle]]]:
    """Yield for each group the map fitted to all other presses, the group, and its contacts.

    Args:
        presses: Presses.
        ball: Ball.
        options: Fit options; the seed also assigns the groups.
        folds: Number of groups.

    Yields:
        Map, presses and contacts of each group.

    Raises:
        ConfigError: There are fewer presses than folds, or fewer than two folds.
    """
    if not 2 <= folds <= len(presses):
        raise ConfigError(f"folds={folds}: give 2 to {len(presses)}, the number of presses.")
    order = np.random.default_rng(options.seed).permutation(len(presses))
    for fold in range(folds):
        group = set(order[fold::folds].tolist())
        training = [press for i, press in enumerate(presses) if i not in group]
        left_out = [press for i, press in enumerate(presses) if i in group]
        slope_map, _ = fit_map(training, ball, options)
        yield slope_map, left_out, [fit_new_circle(press, slope_map, ball) for press in left_out]


def select_map(
    presses: Sequence[BallPress],
    ball: Ball,
    options: FitOptions | None = None,
    folds: int = 3,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[str, dict[str, MapQuality]]:
    """Select the map with the smallest error on left-out presses.

    Args:
        presses: Presses.
        ball: Ball.
        options: Fit options; `map` is ignored.
        folds: Number of groups.
        progress: Callback with the number of evaluated maps and of all.

    Returns:
        The name of the map, and the errors of each by name.

    Raises:
        ConfigError: There are fewer presses than folds, or fewer than two folds.
    """
    options, names = options or FitOptions(), SENSOR_MAPS.names()
    quality = {}
    for number, name in enumerate(names):
        candidate = replace(options, map=SENSOR_MAPS.build(name))
        quality[name] = cross_validate(presses, ball, candidate, folds)
        if progress is not None:
            progress(number + 1, len(names))
    return min(quality, key=lambda name: sum(quality[name].mae)), quality


def fit_new_circle(press: BallPress, slope_map: SlopeMap, ball: Ball) -> Circle:
    """Fit the contact of a left-out press in two passes, since the first changes the radius."""
    first = fit_circle(press, slope_map, ball, press.circle)
    return fit_circle(press, slope_map, ball, first)


def pool_quality(parts: Sequence[MapQuality]) -> MapQuality:
    """Pool the errors of groups, weighted by their pixels."""
    weights = np.array([part.pixels for part in parts], dtype=float)
    weights /= weights.sum()

    def mean(values: Sequence[float]) -> float:
        return float(weights @ np.array(values))

    r2, mae = (
        tuple(mean([getattr(part, name)[axis] for part in parts]) for axis in (0, 1))
        for name in ("r2", "mae")
    )
    depth = float(np.sqrt(mean([part.depth_rms_mm**2 for part in parts])))
    return MapQuality((r2[0], r2[1]), (mae[0], mae[1]), depth, sum(part.pixels for part in parts))

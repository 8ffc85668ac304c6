"""Accuracy of maps from colors to slopes on presses of a ball, and selection of a map."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tactorch.errors import ConfigError
from tactorch.sensor.calibration.ball import Ball, BallPress
from tactorch.sensor.calibration.fit import (
    EVALUATED_RADIUS,
    FLAT_RADIUS,
    FitOptions,
    fit_map,
    fit_new_contact,
)
from tactorch.sensor.calibration.maps import SENSOR_MAPS, SlopeMap, map_slopes
from tactorch.sensor.depth import integrate_slopes

_MIN_SPREAD = 2.0  # range of the centers, over the contact radius, for maps that use the position
_POSITION_GAIN = 0.05  # of the error, from which the position of pixels is worth using


@dataclass(frozen=True)
class MapQuality:
    """Errors inside the contacts of presses.

    Attributes:
        r2: Coefficient of determination of the slopes along x and y.
        mae: Mean absolute error of the slopes along x and y.
        depth_rms_mm: Root mean square error of the ball's height up to a constant, mm.
        pixels: Number of evaluated pixels.
        flat_slope: Root mean square slope beyond 2.5 contact radii, where it is about zero; NaN if
            there are no such pixels.
    """

    r2: tuple[float, float]
    mae: tuple[float, float]
    depth_rms_mm: float
    pixels: int
    flat_slope: float = float("nan")

    @classmethod
    def pool(cls, parts: "Sequence[MapQuality]") -> "MapQuality":
        """Return the errors of groups of presses, weighted by their pixels."""
        counts = [part.pixels for part in parts]
        rows = [(*part.r2, *part.mae, part.depth_rms_mm**2) for part in parts]
        *slopes, square = np.average(rows, axis=0, weights=counts).tolist()
        flat = _root_mean_square(np.array([part.flat_slope for part in parts]))
        return cls(tuple(slopes[:2]), tuple(slopes[2:]), square**0.5, sum(counts), flat)


def evaluate_map(slope_map: SlopeMap, presses: Sequence[BallPress], ball: Ball) -> MapQuality:
    """Return the errors of the slopes and heights of a map for all presses together.

    They are compared with those of the ball at the contacts of the presses.
    """
    results = [_compare(slope_map, press, ball) for press in presses]
    slopes, expected, heights, flat = (
        np.concatenate(parts) for parts in zip(*results, strict=True)
    )
    spread = ((expected - expected.mean(axis=0)) ** 2).sum(axis=0)
    r2 = 1 - ((slopes - expected) ** 2).sum(axis=0) / spread
    mae = np.abs(slopes - expected).mean(axis=0)
    depth = float(np.sqrt(np.mean(heights**2)))
    outside = _root_mean_square(flat)
    return MapQuality(tuple(r2.tolist()), tuple(mae.tolist()), depth, len(slopes), outside)


def _root_mean_square(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else float("nan")


def _compare(slope_map: SlopeMap, press: BallPress, ball: Ball) -> tuple[np.ndarray, ...]:
    """Slopes of the map and of the ball, errors of the height, and slopes of the flat face."""
    slopes, circle = map_slopes(slope_map, press.change), press.contact
    contact = ball.distance(press.shape, circle) < EVALUATED_RADIUS
    inside = press.known & contact
    height = integrate_slopes(slopes[..., 0], slopes[..., 1], ball.mm_per_px)
    error = (height - ball.heights(press.shape, circle))[contact]
    flat = press.known & (ball.distance(press.shape, circle) > FLAT_RADIUS)
    flat_slopes = np.linalg.norm(slopes[flat], axis=-1)
    expected = ball.slopes(press.shape, circle)[inside]
    return slopes[inside], expected, error - error.mean(), flat_slopes


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

    Maps of other packages are imported where they are chosen by name, and are no candidates. A map
    that uses the position of pixels is only selected if its error is smaller by 5 %, and if
    the presses are not all at one position. Arguments are those of `cross_validate`, and a callback
    with the number of evaluated maps and of all. `map` of the options is ignored.

    Returns:
        The name of the map, and the errors of each evaluated map by name.
    """
    options, quality = options or FitOptions(), dict[str, MapQuality]()
    differ = positions_differ(presses)
    others = SENSOR_MAPS.plugins()
    maps = {name: SENSOR_MAPS.build(name) for name in SENSOR_MAPS if name not in others}
    maps = {k: m for k, m in maps.items() if m.automatic and (differ or not m.uses_position)}
    for number, (name, candidate) in enumerate(maps.items(), start=1):
        quality[name] = cross_validate(presses, ball, replace(options, map=candidate), folds)
        progress(number, len(maps))

    def score(name: str) -> float:
        gain = _POSITION_GAIN if maps[name].uses_position else 0.0
        return sum(quality[name].mae) / (1.0 - gain)

    return min(maps, key=score), quality


def positions_differ(presses: Sequence[BallPress]) -> bool:
    """Return whether the presses are spread over the image by more than a contact's diameter.

    Slopes at other positions are otherwise extrapolated by maps that use the position.
    """
    centers = np.array([press.contact.center_px for press in presses])
    radius = float(np.median([press.contact.radius_px for press in presses]))
    return bool(np.ptp(centers, axis=0).max() > _MIN_SPREAD * radius)

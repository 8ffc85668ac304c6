"""Which map to take: the one that errs least on presses that it was not fitted to."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from tactorch.errors import ConfigError
from tactorch.sensor.calibration.ball import Ball, Circle
from tactorch.sensor.calibration.fit import FitOptions, Touch, fit_circle, fit_map
from tactorch.sensor.calibration.maps import MAPS, SlopeMap
from tactorch.sensor.calibration.quality import Quality, judge


def held_out_quality(
    touches: Sequence[Touch], ball: Ball, options: FitOptions | None = None, folds: int = 3
) -> Quality:
    """Return how well presses are seen that were left out of the fit, each once.

    The circles of presses left out are fitted to them: to their pixels by the thousand, three
    numbers.

    Args:
        touches: Presses.
        ball: What was pressed.
        options: How the map is found.
        folds: In how many groups presses are left out.

    Raises:
        ConfigError: There are fewer presses than folds, or fewer than two folds.
    """
    groups = left_out(touches, ball, options or FitOptions(), folds)
    return together([judge(found, left, circles, ball) for found, left, circles in groups])


def left_out(
    touches: Sequence[Touch], ball: Ball, options: FitOptions, folds: int
) -> Iterator[tuple[SlopeMap, list[Touch], list[Circle]]]:
    """Yield for each group of presses the map that the others tell, the group, and its circles.

    Args:
        touches: Presses.
        ball: What was pressed.
        options: How the map is found; its seed deals out the groups too.
        folds: In how many groups presses are left out.

    Raises:
        ConfigError: There are fewer presses than folds, or fewer than two folds.
    """
    if not 2 <= folds <= len(touches):
        raise ConfigError(f"folds={folds}: give 2 to {len(touches)}, the number of presses.")
    order = np.random.default_rng(options.seed).permutation(len(touches))
    for fold in range(folds):
        out = set(order[fold::folds].tolist())
        used = [touch for i, touch in enumerate(touches) if i not in out]
        left = [touch for i, touch in enumerate(touches) if i in out]
        found, _ = fit_map(used, ball, options)
        yield found, left, [new_circle(touch, found, ball) for touch in left]


def choose_map(
    touches: Sequence[Touch],
    ball: Ball,
    options: FitOptions | None = None,
    folds: int = 3,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[str, dict[str, Quality]]:
    """Return the name of the map that errs least on presses left out, and how well each does.

    Args:
        touches: Presses.
        ball: What was pressed.
        options: How maps are found; its `map` does not count.
        folds: In how many groups presses are left out.
        progress: Called with the maps done and their number.

    Raises:
        ConfigError: There are fewer presses than folds, or fewer than two folds.
    """
    options = options or FitOptions()
    found = {}
    for number, name in enumerate(MAPS):
        found[name] = held_out_quality(touches, ball, replace(options, map=name), folds)
        if progress is not None:
            progress(number + 1, len(MAPS))
    return min(found, key=lambda name: sum(found[name].mae)), found


def new_circle(touch: Touch, found: SlopeMap, ball: Ball) -> Circle:
    """Fit the circle of a press that was left out, twice: the second from the first's radius."""
    return fit_circle(touch, found, ball, fit_circle(touch, found, ball, touch.circle))


def together(parts: Sequence[Quality]) -> Quality:
    """Mean of what folds were judged at, by their pixels."""
    weights = np.array([part.pixels for part in parts], dtype=float)
    weights /= weights.sum()

    def mean(values: Sequence[float]) -> float:
        return float(weights @ np.array(values))

    r2, mae = (
        tuple(mean([getattr(part, name)[axis] for part in parts]) for axis in (0, 1))
        for name in ("r2", "mae")
    )
    depth = float(np.sqrt(mean([part.depth_rms_mm**2 for part in parts])))
    return Quality((r2[0], r2[1]), (mae[0], mae[1]), depth, sum(part.pixels for part in parts))

r"""`tactorch sensor calibrate`: fit the map from colours to slopes, from presses of a ball.

    tactorch sensor calibrate sensor=gelsight_mini images=presses reference=still.png \
      ball_radius_mm=2.35 out=calib.npz
    tactorch sensor calibrate ... labels=contacts.csv held_out=6 map=mlp
    tactorch sensor calibrate ... folds=6              few presses: cross-validation

The run folder gets calib.npz, quality.json and .txt, circles.csv (the contacts found, to be
corrected and given as labels=) and held_out.png: each held-out press and the ball.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from tactorch.cli.progress import progress
from tactorch.cli.sensor.inputs import look_of, reference_of, sensor_of
from tactorch.cli.sensor.options import CalibrateSettings
from tactorch.cli.sensor.presses import Pressed, presses_of
from tactorch.cli.sensor.quality import RESULTS, Judged, write_report
from tactorch.cli.settings import log, run_folder
from tactorch.config import to_mapping
from tactorch.errors import ConfigError
from tactorch.sensor.calibration import (
    SENSOR_MAPS,
    Ball,
    Calibration,
    Circle,
    FitOptions,
    MapQuality,
    SlopeMap,
    evaluate_map,
    fit_map,
    fit_new_circle,
    pool_quality,
    save_calibration,
    select_map,
    validation_groups,
)

AUTO = "auto"
_SHARE = 4  # one in so many presses is held out
_CHOOSE = 3  # groups of presses left out to choose a map


@dataclass(frozen=True, eq=False)
class Fitted:
    """A map, what it was fitted to, and how it does on presses that it was not.

    Attributes:
        map: The map.
        circles: Of the presses that it was fitted to.
        judged: Presses with the circles and maps that they were judged with.
        quality: Of those pool_quality.
        title: What was judged on what.
    """

    map: SlopeMap
    circles: Mapping[str, Circle]
    judged: Sequence[Judged]
    quality: MapQuality
    title: str


def run(cfg: CalibrateSettings) -> Path:
    """Calibrate a sensor; returns the path of the calibration."""
    place = run_folder()
    out = place / "calib.npz" if cfg.out is None else cfg.out
    for name in RESULTS:
        (place / name).unlink(missing_ok=True)
    options = _options(cfg)
    sensor = sensor_of(cfg)
    x, y = map(float, sensor.mm_per_px)
    ball = Ball(cfg.ball_radius_mm, (x, y))
    reference = reference_of(cfg.reference, cfg.reference_frames, sensor)
    look = look_of(sensor, cfg.marker_diameter_px)
    presses = presses_of(cfg, sensor, ball, reference, look)
    used, held = _parted(presses, cfg, options.seed)
    options, maps = _with_map(cfg.map, used, ball, options)
    fit = _in_folds if cfg.folds is not None else _held_out
    found = fit(used, held, ball, options, cfg.folds or 0)
    facts = {
        "sensor": sensor.name,
        "ball_radius_mm": ball.radius_mm,
        "fit": to_mapping(options),
        "maps": {name: asdict(quality) for name, quality in maps.items()},
        "judged": found.title,
        "quality": asdict(found.quality),
        "fitted_to": {one.touch.name: digest(one) for one in used},
    }
    save_calibration(Calibration(found.map, reference, ball.mm_per_px, look, facts), out)
    new = {one.pressed.touch.name: one.circle for one in found.judged}
    write_report(
        place, found.title, found.quality, found.judged, ball, {**new, **found.circles}, facts
    )
    log.info("calibration: %s", out)
    return out


def digest(pressed: Pressed) -> str:
    """Return what tells an image from another."""
    return sha256(np.ascontiguousarray(pressed.image).tobytes()).hexdigest()[:16]


def _options(cfg: CalibrateSettings) -> FitOptions:
    names = (AUTO, *SENSOR_MAPS.names())
    if cfg.map not in names:
        raise ConfigError(f"map={cfg.map!r}: choose one of {', '.join(names)}.")
    if cfg.folds is not None and cfg.held_out is not None:
        raise ConfigError("give held_out or folds, not both.")
    name = names[1] if cfg.map == AUTO else cfg.map
    return FitOptions(SENSOR_MAPS.build(name), cfg.rounds, cfg.seed)


def _map_name(options: FitOptions) -> str:
    return SENSOR_MAPS.name_of(type(options.map))


def _parted(
    presses: list[Pressed], cfg: CalibrateSettings, seed: int
) -> tuple[list[Pressed], list[Pressed]]:
    """Return presses to fit to, and those held out."""
    if cfg.folds is not None:
        if not 2 <= cfg.folds <= len(presses):
            raise ConfigError(f"folds={cfg.folds}: there are {len(presses)} presses; give 2 to it.")
        return presses, []
    count = max(1, len(presses) // _SHARE) if cfg.held_out is None else cfg.held_out
    if not 0 <= count < len(presses):
        raise ConfigError(
            f"held_out={count} of {len(presses)} presses leaves none to fit to; add presses, or"
            " give held_out=0 to do without a judgement."
        )
    order = np.random.default_rng(seed).permutation(len(presses)).tolist()
    held = set(order[:count])
    return (
        [one for k, one in enumerate(presses) if k not in held],
        [presses[k] for k in sorted(held)],
    )


def _with_map(
    name: str, used: list[Pressed], ball: Ball, options: FitOptions
) -> tuple[FitOptions, Mapping[str, MapQuality]]:
    """Choose the map, on presses that may be fitted to."""
    if name != AUTO:
        return options, {}
    if len(used) < 2:
        raise ConfigError("map=auto takes two presses or more to fit to; give map=mlp_colour.")
    touches = [one.touch for one in used]
    with progress("choosing a map", "maps") as tell:
        chosen, maps = select_map(touches, ball, options, min(_CHOOSE, len(used)), tell)
    for each, quality in maps.items():
        log.info("%s: mean error of slopes %.4f / %.4f on presses left out", each, *quality.mae)
    return replace(options, map=SENSOR_MAPS.build(chosen)), maps


def _held_out(
    used: list[Pressed], held: list[Pressed], ball: Ball, options: FitOptions, _: Any
) -> Fitted:
    found, circles = _fit(used, ball, options)
    if held:
        judged = [Judged(one, fit_new_circle(one.touch, found, ball), found) for one in held]
        title = f"{_map_name(options)}, fitted to {len(used)} presses, on {len(held)} others"
    else:
        judged = [Judged(one, circles[one.touch.name], found) for one in used]
        title = (
            f"{_map_name(options)}, on the {len(used)} presses it was fitted to: others do worse"
        )
    touches, own = [one.pressed.touch for one in judged], [one.circle for one in judged]
    return Fitted(found, circles, judged, evaluate_map(found, touches, own, ball), title)


def _in_folds(
    used: list[Pressed], _: list[Pressed], ball: Ball, options: FitOptions, folds: int
) -> Fitted:
    by_name = {one.touch.name: one for one in used}
    judged, parts = [], []
    with progress("judging", "groups left out") as tell:
        for found, left, circles in validation_groups(
            [p.touch for p in used], ball, options, folds
        ):
            parts.append(evaluate_map(found, left, circles, ball))
            pairs = zip(left, circles, strict=True)
            judged += [Judged(by_name[t.name], circle, found) for t, circle in pairs]
            tell(len(parts), folds)
    title = f"{_map_name(options)}, on {len(used)} presses, each left out once, in {folds} groups"
    final, own = _fit(used, ball, options)
    return Fitted(final, own, judged, pool_quality(parts), title)


def _fit(
    used: list[Pressed], ball: Ball, options: FitOptions
) -> tuple[SlopeMap, Mapping[str, Circle]]:
    with progress("fitting map and contacts", "rounds") as tell:
        return fit_map([one.touch for one in used], ball, options, tell)

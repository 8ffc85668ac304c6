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
from pathlib import Path

import numpy as np

from tactorch.cli.console import log, progress
from tactorch.cli.sensor.inputs import load_reference, load_sensor_settings, marker_appearance
from tactorch.cli.sensor.options import CalibrateSettings
from tactorch.cli.sensor.presses import (
    EvaluatedPress,
    PressImage,
    prepare_folder,
    read_presses,
    write_report,
)
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
    save_calibration,
    select_map,
)
from tactorch.sensor.calibration.fit import fit_new_circle, validation_groups

AUTO = "auto"
_HELD_OUT_FRACTION = 4  # one press in four is held out
_SELECTION_GROUPS = 3  # of presses left out to select a map


@dataclass(frozen=True, eq=False)
class _Evaluation:
    """Fitted map, and its accuracy on presses that were held out.

    Attributes:
        map: Map.
        circles: Contacts of the presses that it was fitted to.
        presses: Evaluated presses, with the contacts and maps used for them.
        quality: Accuracy on these presses together.
        title: Description of the evaluation.
    """

    map: SlopeMap
    circles: Mapping[str, Circle]
    presses: Sequence[EvaluatedPress]
    quality: MapQuality
    title: str


def run(cfg: CalibrateSettings) -> Path:
    """Calibrate a sensor; returns the path of the calibration."""
    folder = prepare_folder()
    out = folder / "calib.npz" if cfg.out is None else cfg.out
    options = _fit_options(cfg)
    sensor = load_sensor_settings(cfg)
    ball = Ball(cfg.ball_radius_mm, sensor.mm_per_px)
    reference = load_reference(cfg.reference, cfg.reference_frames, sensor)
    markers = marker_appearance(sensor, cfg.marker_diameter_px)
    presses = read_presses(cfg, sensor, ball, reference, markers)
    training, held_out = _split(presses, cfg, options.seed)
    options, maps = _select_map(cfg.map, training, ball, options)
    if cfg.folds is None:
        result = _evaluate_held_out(training, held_out, ball, options)
    else:
        result = _cross_validate(training, ball, options, cfg.folds)
    facts = {
        "sensor": sensor.name,
        "ball_radius_mm": ball.radius_mm,
        "fit": to_mapping(options),
        "maps": {name: asdict(quality) for name, quality in maps.items()},
        "judged": result.title,
        "quality": asdict(result.quality),
        "fitted_to": {press.name: press.digest for press in training},
    }
    save_calibration(Calibration(result.map, reference, ball.mm_per_px, markers, facts), out)
    circles = {one.source.name: one.circle for one in result.presses} | dict(result.circles)
    write_report(folder, result.title, result.quality, result.presses, ball, circles, facts)
    log.info("calibration: %s", out)
    return out


def _fit_options(cfg: CalibrateSettings) -> FitOptions:
    names = (AUTO, *SENSOR_MAPS.names())
    if cfg.map not in names:
        raise ConfigError(f"map={cfg.map!r}: choose one of {', '.join(names)}.")
    if cfg.folds is not None and cfg.held_out is not None:
        raise ConfigError("give held_out or folds, not both.")
    name = names[1] if cfg.map == AUTO else cfg.map
    return FitOptions(SENSOR_MAPS.build(name), cfg.rounds, cfg.seed)


def _map_name(options: FitOptions) -> str:
    return SENSOR_MAPS.name_of(type(options.map))


def _split(
    presses: list[PressImage], cfg: CalibrateSettings, seed: int
) -> tuple[list[PressImage], list[PressImage]]:
    """Return presses for the fit and held-out presses."""
    if cfg.folds is not None:
        if not 2 <= cfg.folds <= len(presses):
            raise ConfigError(f"folds={cfg.folds}: there are {len(presses)} presses; give 2 to it.")
        return presses, []
    default = max(1, len(presses) // _HELD_OUT_FRACTION)
    count = default if cfg.held_out is None else cfg.held_out
    if not 0 <= count < len(presses):
        raise ConfigError(
            f"held_out={count} of {len(presses)} presses leaves none to fit to; add presses, or"
            " give held_out=0 to do without a judgement."
        )
    order = np.random.default_rng(seed).permutation(len(presses)).tolist()
    held_out = set(order[:count])
    training = [press for k, press in enumerate(presses) if k not in held_out]
    return training, [presses[k] for k in sorted(held_out)]


def _select_map(
    name: str, training: list[PressImage], ball: Ball, options: FitOptions
) -> tuple[FitOptions, Mapping[str, MapQuality]]:
    """Select the map by cross-validation on the presses for the fit."""
    if name != AUTO:
        return options, {}
    if len(training) < 2:
        raise ConfigError("map=auto takes two presses or more to fit to; give map=mlp_colour.")
    presses = [one.press for one in training]
    groups = min(_SELECTION_GROUPS, len(training))
    with progress("choosing a map", "maps") as report:
        selected, maps = select_map(presses, ball, options, groups, report)
    for each, quality in maps.items():
        log.info("%s: mean error of slopes %.4f / %.4f on presses left out", each, *quality.mae)
    return replace(options, map=SENSOR_MAPS.build(selected)), maps


def _evaluate_held_out(
    training: list[PressImage], held_out: list[PressImage], ball: Ball, options: FitOptions
) -> _Evaluation:
    slope_map, circles = _fit(training, ball, options)
    name, count = _map_name(options), len(training)
    if held_out:
        presses = [
            EvaluatedPress(one, fit_new_circle(one.press, slope_map, ball), slope_map)
            for one in held_out
        ]
        title = f"{name}, fitted to {count} presses, on {len(held_out)} others"
    else:
        presses = [EvaluatedPress(one, circles[one.name], slope_map) for one in training]
        title = f"{name}, on the {count} presses it was fitted to: others do worse"
    sources, fitted = [one.source.press for one in presses], [one.circle for one in presses]
    quality = evaluate_map(slope_map, sources, fitted, ball)
    return _Evaluation(slope_map, circles, presses, quality, title)


def _cross_validate(
    training: list[PressImage], ball: Ball, options: FitOptions, folds: int
) -> _Evaluation:
    by_name = {one.name: one for one in training}
    presses, parts = [], []
    groups = validation_groups([one.press for one in training], ball, options, folds)
    with progress("judging", "groups left out") as report:
        for slope_map, left_out, circles in groups:
            parts.append(evaluate_map(slope_map, left_out, circles, ball))
            pairs = zip(left_out, circles, strict=True)
            presses += [EvaluatedPress(by_name[p.name], c, slope_map) for p, c in pairs]
            report(len(parts), folds)
    count = len(training)
    title = f"{_map_name(options)}, on {count} presses, each left out once, in {folds} groups"
    final, fitted = _fit(training, ball, options)
    return _Evaluation(final, fitted, presses, MapQuality.pool(parts), title)


def _fit(
    training: list[PressImage], ball: Ball, options: FitOptions
) -> tuple[SlopeMap, Mapping[str, Circle]]:
    with progress("fitting map and contacts", "rounds") as report:
        return fit_map([one.press for one in training], ball, options, report)

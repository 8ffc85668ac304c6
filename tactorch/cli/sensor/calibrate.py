r"""`tactorch sensor calibrate`: fit the map from colours to slopes, from presses of a ball.

    tactorch sensor calibrate sensor=gelsight_mini images=presses reference=still.png \
      ball_radius_mm=2.35 out=calib.npz
    tactorch sensor calibrate ... labels=contacts.csv held_out=6 map=mlp
    tactorch sensor calibrate ... folds=6              few presses: cross-validation

The run folder gets calib.npz, quality.json and .txt, circles.csv (the contacts found, to be
corrected and given as labels=) and held_out.png: each held-out press and the ball. The accuracy is
that of a map fitted without the held-out presses; the calibration is fitted to all presses.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tactorch.cli.console import log, progress
from tactorch.cli.sensor.inputs import load_sensor_settings
from tactorch.cli.sensor.options import CalibrateSettings
from tactorch.cli.sensor.presses import (
    EvaluatedPress,
    checksum,
    prepare_folder,
    read_presses,
    write_report,
)
from tactorch.config import to_mapping
from tactorch.errors import ConfigError
from tactorch.sensor.calibration import (
    SENSOR_MAPS,
    Ball,
    BallPress,
    Calibration,
    FitOptions,
    MapQuality,
    SlopeMap,
    evaluate_map,
    fit_map,
    save_calibration,
    select_map,
)
from tactorch.sensor.calibration.fit import fit_new_contact, fit_to_contacts
from tactorch.sensor.calibration.quality import positions_differ, validation_groups
from tactorch.sensor.frames import read_reference
from tactorch.sensor.light import COLOUR_UNIT
from tactorch.sensor.markers import marker_appearance

if TYPE_CHECKING:
    from tactorch.sensor.camera import LightFit

AUTO = "auto"
_HELD_OUT_FRACTION = 4  # one press in four is held out
_SELECTION_GROUPS = 3  # of presses left out to select a map


def run(cfg: CalibrateSettings) -> Path:
    """Calibrate a sensor; returns the path of the calibration."""
    folder = prepare_folder()
    out = folder / "calib.npz" if cfg.out is None else cfg.out
    options, sensor = _fit_options(cfg), load_sensor_settings(cfg)
    ball = Ball(cfg.ball_radius_mm, sensor.mm_per_px)
    reference = read_reference(cfg.reference, sensor, cfg.reference_frames)
    markers = marker_appearance(sensor, cfg.marker_diameter_px)
    presses, images = read_presses(cfg, sensor, ball, reference, markers)
    training, held_out = _split(presses, cfg)
    options, maps = _select_map(cfg.map, training, ball, options)
    if options.map.uses_position and not positions_differ(presses):
        log.info(
            "warning: all presses are at one position, but the map '%s' uses the position; slopes"
            " elsewhere are extrapolated. Add presses all over the gel, or give map=mlp_colour.",
            SENSOR_MAPS.name_of(type(options.map)),
        )
    with progress("fitting map and contacts", "rounds") as report:
        slope_map, fitted = fit_map(training, ball, options, report)
    title = f"{SENSOR_MAPS.name_of(type(options.map))}, "
    if cfg.folds is not None:
        evaluated, quality = _cross_validate(training, ball, options, cfg.folds)
        title += f"on {len(training)} presses, each left out once, in {cfg.folds} groups"
    else:
        if held_out:
            others = [fit_new_contact(press, slope_map, ball) for press in held_out]
            title += f"fitted to {len(training)} presses, on {len(held_out)} others"
        else:
            others = fitted
            title += f"on the {len(training)} presses it was fitted to: others do worse"
        evaluated = [(press, slope_map) for press in others]
        quality = evaluate_map(slope_map, [p for p in others if not p.outlying] or others, ball)
    if held_out:  # the calibration is fitted to all presses
        with progress("fitting to all presses", "rounds") as report:
            slope_map, fitted = fit_map(presses, ball, options, report)
    _report_outlying(fitted)
    light = _fit_light(fitted, slope_map, ball, options) if cfg.camera else None
    facts = {
        "sensor": sensor.name,
        "ball_radius_mm": ball.radius_mm,
        "fit": to_mapping(options),
        "maps": {name: asdict(each) for name, each in maps.items()},
        "evaluated": title,
        "quality": asdict(quality),
        "fitted_to": {press.name: checksum(images[press.name]) for press in fitted},
        "held_out": [press.name for press in held_out],
        "outlying": [press.name for press in fitted if press.outlying],
    }
    if light is not None:
        facts["camera"] = {"deviation_gray_values": COLOUR_UNIT * light.deviation}
    calibration = Calibration(slope_map, reference, ball.mm_per_px, markers, facts, light)
    save_calibration(calibration, out)
    write_report(folder, title, quality, evaluated, images, ball, fitted, facts)
    log.info("calibration: %s", out)
    return out


def _fit_light(
    presses: Sequence[BallPress], slope_map: SlopeMap, ball: Ball, options: FitOptions
) -> "LightFit":
    from tactorch.sensor.calibration.camera import CameraLight, CameraMap

    fitted = fit_to_contacts(CameraLight(), presses, slope_map, ball, options.seed)
    assert isinstance(fitted, CameraMap)
    assert fitted.light is not None
    difference = COLOUR_UNIT * fitted.light.deviation
    log.info("camera: rendered colours differ by %.1f gray values from those seen", difference)
    return fitted.light


def _report_outlying(presses: Sequence[BallPress]) -> None:
    names = [press.name for press in presses if press.outlying]
    if names:
        log.info(
            "warning: %d of %d presses disagree with the others, and the map is not fitted to them:"
            " %s. Look at them in held_out.png; label their contacts, or leave them out.",
            len(names), len(presses), ", ".join(names),
        )  # fmt: skip


def _fit_options(cfg: CalibrateSettings) -> FitOptions:
    names = (AUTO, *SENSOR_MAPS.names())
    if cfg.map not in names:
        raise ConfigError(f"map={cfg.map!r}: choose one of {', '.join(names)}.")
    if cfg.folds is not None and cfg.held_out is not None:
        raise ConfigError("give held_out or folds, not both.")
    name = names[1] if cfg.map == AUTO else cfg.map
    return FitOptions(SENSOR_MAPS.build(name), cfg.rounds, cfg.seed)


def _split(
    presses: list[BallPress], cfg: CalibrateSettings
) -> tuple[list[BallPress], list[BallPress]]:
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
            " give held_out=0 to evaluate on the fitted presses."
        )
    order = np.random.default_rng(cfg.seed).permutation(len(presses)).tolist()
    held_out = set(order[:count])
    training = [press for k, press in enumerate(presses) if k not in held_out]
    return training, [presses[k] for k in sorted(held_out)]


def _select_map(
    name: str, training: Sequence[BallPress], ball: Ball, options: FitOptions
) -> tuple[FitOptions, Mapping[str, MapQuality]]:
    """Select the map by cross-validation on the presses for the fit."""
    if name != AUTO:
        return options, {}
    if len(training) < 2:
        raise ConfigError("map=auto takes two presses or more to fit to; give map=mlp_colour.")
    groups = min(_SELECTION_GROUPS, len(training))
    with progress("choosing a map", "maps") as report:
        selected, maps = select_map(training, ball, options, groups, report)
    for each, quality in maps.items():
        log.info("%s: mean error of slopes %.4f / %.4f on presses left out", each, *quality.mae)
    return replace(options, map=SENSOR_MAPS.build(selected)), maps


def _cross_validate(
    training: Sequence[BallPress], ball: Ball, options: FitOptions, folds: int
) -> tuple[list[EvaluatedPress], MapQuality]:
    evaluated, parts = list[EvaluatedPress](), []
    with progress("evaluating", "groups left out") as report:
        for slope_map, group in validation_groups(training, ball, options, folds):
            parts.append(evaluate_map(slope_map, group, ball))
            evaluated += [(press, slope_map) for press in group]
            report(len(parts), folds)
    return evaluated, MapQuality.pool(parts)

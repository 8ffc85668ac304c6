"""`tactorch sensor check`."""

from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from tactorch.cli.sensor.calibrate import digest
from tactorch.cli.sensor.inputs import calibrated, reference_of
from tactorch.cli.sensor.presses import presses_of
from tactorch.cli.sensor.quality import RESULTS, Judged, write_report
from tactorch.cli.settings import folder, log
from tactorch.sensor.calibration import Ball, MapQuality, evaluate_map, fit_new_circle


def run(cfg: DictConfig) -> MapQuality:
    """Judge a calibration."""
    place = folder()
    for name in RESULTS:
        (place / name).unlink(missing_ok=True)
    sensor, calibration = calibrated(cfg)
    ball = Ball(float(cfg.ball_radius_mm), calibration.mm_per_px)
    reference = calibration.reference if cfg.reference is None else reference_of(cfg, sensor)
    presses = presses_of(cfg, sensor, ball, reference, calibration.markers)
    judged = [
        Judged(one, fit_new_circle(one.touch, calibration.map, ball), calibration.map)
        for one in presses
    ]
    circles = {one.pressed.touch.name: one.circle for one in judged}
    touches = [one.touch for one in presses]
    quality = evaluate_map(calibration.map, touches, list(circles.values()), ball)
    known = set(calibration.facts.get("fitted_to", {}).values())
    seen = [one.touch.name for one in presses if digest(one) in known]
    title = f"{Path(str(cfg.calibration)).name} ({calibration.map_name}), on {len(judged)} presses"
    more: dict[str, Any] = {"calibration": calibration.facts, "fitted_to": seen}
    write_report(place, title, quality, judged, ball, circles, more)
    if seen:
        log.info(
            "warning: the calibration was fitted to %d of these presses (%s); leave them out.",
            len(seen),
            ", ".join(seen[:3]) + (", ..." if len(seen) > 3 else ""),
        )
    return quality

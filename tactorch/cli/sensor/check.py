r"""`tactorch sensor check`: test a calibration on presses that it was not fitted to.

    tactorch sensor check sensor=gelsight_mini calibration=calib.npz images=other \
      ball_radius_mm=2.35

The run folder gets quality.json and .txt, circles.csv and held_out.png. Presses that the
calibration was fitted to are named: their figures are no test of the calibration.
"""

from typing import Any

from tactorch.cli.sensor.calibrate import digest
from tactorch.cli.sensor.inputs import calibrated, reference_of
from tactorch.cli.sensor.options import CheckSettings
from tactorch.cli.sensor.presses import presses_of
from tactorch.cli.sensor.quality import RESULTS, Judged, write_report
from tactorch.cli.settings import log, run_folder
from tactorch.sensor.calibration import Ball, MapQuality, evaluate_map, fit_new_circle


def run(cfg: CheckSettings) -> MapQuality:
    """Judge a calibration."""
    place = run_folder()
    for name in RESULTS:
        (place / name).unlink(missing_ok=True)
    sensor, calibration = calibrated(cfg)
    ball = Ball(cfg.ball_radius_mm, calibration.mm_per_px)
    reference = calibration.reference
    if cfg.reference is not None:
        reference = reference_of(cfg.reference, cfg.reference_frames, sensor)
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
    title = f"{cfg.calibration.name} ({calibration.map_name}), on {len(judged)} presses"
    more: dict[str, Any] = {"calibration": calibration.facts, "fitted_to": seen}
    write_report(place, title, quality, judged, ball, circles, more)
    if seen:
        log.info(
            "warning: the calibration was fitted to %d of these presses (%s); leave them out.",
            len(seen),
            ", ".join(seen[:3]) + (", ..." if len(seen) > 3 else ""),
        )
    return quality

r"""`tactorch sensor check`: test a calibration on presses that it was not fitted to.

    tactorch sensor check sensor=gelsight_mini calibration=calib.npz images=other \
      ball_radius_mm=2.35

The run folder gets quality.json and .txt, circles.csv and held_out.png. Presses that the
calibration was fitted to are named: their figures are no test of the calibration.
"""

from typing import Any

from tactorch.cli.console import log
from tactorch.cli.sensor.inputs import load_calibrated, load_reference
from tactorch.cli.sensor.options import CheckSettings
from tactorch.cli.sensor.presses import EvaluatedPress, prepare_folder, read_presses, write_report
from tactorch.sensor.calibration import Ball, MapQuality, evaluate_map
from tactorch.sensor.calibration.fit import fit_new_circle


def run(cfg: CheckSettings) -> MapQuality:
    """Evaluate a calibration."""
    folder = prepare_folder()
    sensor, calibration = load_calibrated(cfg)
    ball = Ball(cfg.ball_radius_mm, calibration.mm_per_px)
    reference = calibration.reference
    if cfg.reference is not None:
        reference = load_reference(cfg.reference, cfg.reference_frames, sensor)
    presses = read_presses(cfg, sensor, ball, reference, calibration.markers)
    evaluated = [
        EvaluatedPress(one, fit_new_circle(one.press, calibration.map, ball), calibration.map)
        for one in presses
    ]
    circles = {one.source.name: one.circle for one in evaluated}
    sources = [one.press for one in presses]
    quality = evaluate_map(calibration.map, sources, list(circles.values()), ball)
    known = set(calibration.facts.get("fitted_to", {}).values())
    fitted = [one.name for one in presses if one.digest in known]
    title = f"{cfg.calibration.name} ({calibration.map_name}), on {len(evaluated)} presses"
    facts: dict[str, Any] = {"calibration": calibration.facts, "fitted_to": fitted}
    write_report(folder, title, quality, evaluated, ball, circles, facts)
    if fitted:
        log.info(
            "warning: the calibration was fitted to %d of these presses (%s); leave them out.",
            len(fitted),
            ", ".join(fitted[:3]) + (", ..." if len(fitted) > 3 else ""),
        )
    return quality

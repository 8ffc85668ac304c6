r"""`tactorch sensor check`: test a calibration on presses that it was not fitted to.

    tactorch sensor check sensor=gelsight_mini calibration=calib.npz images=other \
      ball_radius_mm=2.35

The run folder gets quality.json and .txt, circles.csv and held_out.png. Presses that the
calibration was fitted to are named: their figures are no test of the calibration.
"""

from tactorch.cli.console import log
from tactorch.cli.sensor.inputs import load_calibrated
from tactorch.cli.sensor.options import CheckSettings
from tactorch.cli.sensor.presses import checksum, prepare_folder, read_presses, write_report
from tactorch.sensor.calibration import Ball, MapQuality, evaluate_map
from tactorch.sensor.calibration.fit import fit_new_contact
from tactorch.sensor.frames import read_reference


def run(cfg: CheckSettings) -> MapQuality:
    """Evaluate a calibration."""
    folder = prepare_folder()
    sensor, calibration = load_calibrated(cfg)
    ball = Ball(cfg.ball_radius_mm, calibration.mm_per_px)
    reference = calibration.reference
    if cfg.reference is not None:
        reference = read_reference(cfg.reference, sensor, cfg.reference_frames)
    presses, images = read_presses(cfg, sensor, ball, reference, calibration.markers)
    presses = [fit_new_contact(press, calibration.map, ball) for press in presses]
    quality = evaluate_map(calibration.map, presses, ball)
    known = set(calibration.facts.get("fitted_to", {}).values())
    fitted = [name for name, image in images.items() if checksum(image) in known]
    title = f"{cfg.calibration.name} ({calibration.map_name}), on {len(presses)} presses"
    facts = {"calibration": calibration.facts, "fitted_to": fitted}
    evaluated = [(press, calibration.map) for press in presses]
    write_report(folder, title, quality, evaluated, images, ball, [], facts)
    if fitted:
        names = ", ".join(fitted[:3]) + (", ..." if len(fitted) > 3 else "")
        log.info(
            "warning: the calibration was fitted to %d of these presses (%s); leave them out.",
            len(fitted), names,
        )  # fmt: skip
    return quality

"""Presses of a ball for `calibrate` and `check`: images, contacts, and report of the accuracy."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from tactorch.cli.console import Table, log, log_text
from tactorch.cli.sensor.frames import clean_run_folder, write_table
from tactorch.cli.sensor.options import BallSettings
from tactorch.errors import FileError
from tactorch.files import write_file, write_json
from tactorch.sensor.calibration import (
    Ball,
    BallPress,
    MapQuality,
    SlopeMap,
    evaluate_map,
    find_circle,
    image_change,
    marker_pixels,
    read_labels,
)
from tactorch.sensor.calibration.maps import map_slopes
from tactorch.sensor.depth import integrate_slopes, reconstruct_height
from tactorch.sensor.description import SensorDescription
from tactorch.sensor.frames import Image, read_frames
from tactorch.sensor.markers import MarkerAppearance
from tactorch.viz import save_figure
from tactorch.viz.sensor_calibration import PlottedPress, ball_press_figure

_REPORT, _TEXT, _CIRCLES, _PICTURE = "quality.json", "quality.txt", "circles.csv", "held_out.png"

Images = Mapping[str, Image]  # rectified, by name of the press
#: Press with a fitted contact, and a map that was not fitted to this press if possible.
EvaluatedPress = tuple[BallPress, SlopeMap]


def checksum(image: Image) -> str:
    """Return a short checksum of an image, by which it is recognized."""
    return sha256(np.ascontiguousarray(image).tobytes()).hexdigest()[:16]


def prepare_folder() -> Path:
    """Return the run folder, without the results of an earlier run."""
    return clean_run_folder(_REPORT, _TEXT, _CIRCLES, _PICTURE)


def read_presses(
    cfg: BallSettings,
    sensor: SensorDescription,
    ball: Ball,
    reference: Image,
    markers: MarkerAppearance | None,
) -> tuple[list[BallPress], Images]:
    """Read the presses, with labeled or detected contacts, and their images."""
    images = _read_images(cfg, sensor, reference)
    labels = {} if cfg.labels is None else read_labels(str(cfg.labels))
    absent = sorted(labels.keys() - images.keys())
    if absent:
        more = f" and {len(absent) - 1} more" if len(absent) > 1 else ""
        raise FileError(
            f"labels '{cfg.labels}' name '{absent[0]}'{more}, which images '{cfg.images}' do not"
            " hold, or which cannot be read."
        )
    presses = []
    for name, image in images.items():
        change = image_change(image, reference, markers)
        circle = labels.get(name) or find_circle(change, ball, name)
        ball.check(circle, name)
        known = ~marker_pixels(image, reference, markers)
        presses.append(BallPress(name, change, known, circle, labeled=name in labels))
    found = len(images) - len(labels)
    log.info("%d presses: %d contacts by labels, %d found", len(presses), len(labels), found)
    return presses, images


def _read_images(cfg: BallSettings, sensor: SensorDescription, reference: Image) -> Images:
    """Read all readable images but the reference."""
    usable: dict[str, Image] = {}
    faulty = defaultdict(list)
    for frame in read_frames(cfg.images, sensor, reference):
        if frame.image is None or np.array_equal(frame.image, reference):
            log.info("%s is left out: %s", frame.name, frame.fault or "it is the reference")
            continue
        if frame.fault:
            faulty[frame.fault.split(":")[0]].append(frame.name)
        usable[frame.name] = frame.image
    for fault, names in faulty.items():
        log.info("%d images are %s, the first %s; they are used", len(names), fault, names[0])
    if not usable:
        raise FileError(f"images '{cfg.images}' hold no press of the ball that can be read.")
    return usable


def write_report(
    folder: Path,
    title: str,
    quality: MapQuality,
    evaluated: Sequence[EvaluatedPress],
    images: Images,
    ball: Ball,
    training: Sequence[BallPress],
    facts: Mapping[str, Any],
) -> None:
    """Write and log the accuracy of presses together and singly, with contacts and a picture.

    `training` are further presses, which the map was fitted to, `facts` further entries of the JSON
    file.
    """
    presses = {}
    for press, slope_map in evaluated:
        figures = asdict(evaluate_map(slope_map, [press], ball))
        figures["contact_radius_mm"] = press.contact.radius_px * ball.mm_per_px[0]
        presses[press.name] = {**figures, "depth_mm": _depth(press, slope_map, ball)}
    head = (
        "", "R^2 x", "R^2 y", "MAE x", "MAE y", "slope outside", "height rms, mm",
        "contact radius, mm", "depth, mm",
    )  # fmt: skip
    lines = []
    for name, q in [*presses.items(), ("all together", asdict(quality))]:
        sizes = ("", "")
        if name in presses:
            sizes = f"{q['contact_radius_mm']:.2f}", f"{q['depth_mm']:.3f}"
        numbers = [f"{v:.3f}" for v in (*q["r2"], *q["mae"], q["flat_slope"])]
        lines.append((name, *numbers, f"{q['depth_rms_mm']:.4f}", *sizes))
    table = Table(head, lines)
    note = (
        f"Slopes are compared at {quality.pixels} pixels within 0.9 of the contacts' radii;"
        " centers and radii were fitted to these presses. Slopes outside are root mean squares"
        " beyond 2.5 radii, where the gel is flat. Heights are compared up to a constant; depth is"
        " that of the contact's center below the gel far from it. On a thick gel, the depth is the"
        " squared contact radius over the ball's radius."
    )
    report = {"evaluated": title, "quality": asdict(quality), "presses": presses, **facts}
    write_json(folder / _REPORT, report)
    write_file(folder / _TEXT, f"{title}\n{table.text()}\n{note}\n")
    # This table can be used as `labels`.
    circles = {p.name: p.contact for p in (*(press for press, _ in evaluated), *training)}
    header = ("image", "center_x_px", "center_y_px", "radius_px")
    rows = [(n, *(f"{v:.2f}" for v in (*c.center_px, c.radius_px))) for n, c in circles.items()]
    write_table(folder / _CIRCLES, header, rows)
    plotted = [_plotted(p, slope_map, images[p.name], ball) for p, slope_map in evaluated]
    save_figure(ball_press_figure(plotted, title), folder / _PICTURE)
    log_text(title, table, note)
    log.info("pictures of them: %s", folder / _PICTURE)


def _depth(press: BallPress, slope_map: SlopeMap, ball: Ball) -> float:
    """Depth at the center of a contact relative to the gel far from it, mm."""
    height = reconstruct_height(map_slopes(slope_map, press.change), ball.mm_per_px).height_mm
    column, row = (round(value) for value in press.contact.center_px)
    rows, columns = height.shape
    return -float(height[int(np.clip(row, 0, rows - 1)), int(np.clip(column, 0, columns - 1))])


def _plotted(press: BallPress, slope_map: SlopeMap, image: Image, ball: Ball) -> PlottedPress:
    slopes = map_slopes(slope_map, press.change)
    height = integrate_slopes(slopes[..., 0], slopes[..., 1], ball.mm_per_px)
    return PlottedPress(press, image, ball, slopes, height)

"""Presses of a ball for `calibrate` and `check`: images, contacts, and report of the accuracy."""

import csv
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from tactorch.cli.console import Table, log, log_text
from tactorch.cli.outputs import write_json
from tactorch.cli.sensor.options import BallSettings
from tactorch.cli.settings import run_folder
from tactorch.errors import FileError
from tactorch.files import atomic_path
from tactorch.sensor.calibration import (
    Ball,
    BallPress,
    Circle,
    MapQuality,
    SlopeMap,
    evaluate_map,
    find_circle,
    image_change,
    marker_pixels,
    read_labels,
)
from tactorch.sensor.calibration.maps import map_slopes
from tactorch.sensor.depth import integrate_slopes
from tactorch.sensor.description import SensorDescription
from tactorch.sensor.frames import Frame, Image, read_frames
from tactorch.sensor.markers import MarkerAppearance
from tactorch.viz.sensor_calibration import BallPress as PlottedPress
from tactorch.viz.sensor_calibration import plot_ball_presses

_REPORT, _TEXT, _CIRCLES, _PICTURE = "quality.json", "quality.txt", "circles.csv", "held_out.png"


@dataclass(frozen=True, eq=False)
class PressImage:
    """Press of the ball with its image.

    Attributes:
        image: Rectified image.
        press: Press.
    """

    image: Image
    press: BallPress

    @property
    def name(self) -> str:
        """Name of the image."""
        return self.press.name

    @property
    def digest(self) -> str:
        """Checksum of the image."""
        return sha256(np.ascontiguousarray(self.image).tobytes()).hexdigest()[:16]


@dataclass(frozen=True, eq=False)
class EvaluatedPress:
    """Press with a fitted contact and a map, not fitted to this press if possible.

    Attributes:
        source: Press with its image.
        circle: Fitted contact.
        map: Map from colors to slopes.
    """

    source: PressImage
    circle: Circle
    map: SlopeMap


def prepare_folder() -> Path:
    """Return the run folder, without the results of an earlier run."""
    folder = run_folder()
    for name in (_REPORT, _TEXT, _CIRCLES, _PICTURE):
        (folder / name).unlink(missing_ok=True)
    return folder


def read_presses(
    cfg: BallSettings,
    sensor: SensorDescription,
    ball: Ball,
    reference: Image,
    markers: MarkerAppearance | None,
) -> list[PressImage]:
    """Read the presses, with labeled or detected contacts.

    Raises:
        ConfigError: No ball is found in an image, or there is no image left.
        FileError: There are no images, or labels name others.
    """
    frames = _read_images(cfg, sensor, reference)
    labels = {} if cfg.labels is None else read_labels(str(cfg.labels))
    _check_labels(cfg, labels, frames)
    presses = []
    for frame in frames:
        assert frame.image is not None
        change = image_change(frame.image, reference, markers)
        circle = labels.get(frame.name) or find_circle(change, ball, frame.name)
        ball.check(circle, frame.name)
        known = ~marker_pixels(frame.image, reference, markers)
        presses.append(PressImage(frame.image, BallPress(frame.name, change, known, circle)))
    labeled = len(labels.keys() & {frame.name for frame in frames})
    found = len(presses) - labeled
    log.info("%d presses: %d contacts by labels, %d found", len(presses), labeled, found)
    return presses


def _read_images(cfg: BallSettings, sensor: SensorDescription, reference: Image) -> list[Frame]:
    """Read all readable images but the reference."""
    usable, faulty = [], defaultdict(list)
    for frame in read_frames(cfg.images, sensor, reference):
        if frame.image is None or np.array_equal(frame.image, reference):
            log.info("%s is left out: %s", frame.name, frame.fault or "it is the reference")
            continue
        if frame.fault:
            faulty[frame.fault.split(":")[0]].append(frame.name)
        usable.append(frame)
    for fault, names in faulty.items():
        log.info("%d images are %s, the first %s; they are used", len(names), fault, names[0])
    if not usable:
        raise FileError(f"images '{cfg.images}' hold no press of the ball that can be read.")
    return usable


def _check_labels(cfg: BallSettings, labels: Mapping[str, Circle], frames: Sequence[Frame]) -> None:
    absent = sorted(labels.keys() - {frame.name for frame in frames})
    if absent:
        more = f" and {len(absent) - 1} more" if len(absent) > 1 else ""
        raise FileError(
            f"labels '{cfg.labels}' name '{absent[0]}'{more}, which images '{cfg.images}' do not"
            " hold, or which cannot be read."
        )


def write_report(
    folder: Path,
    title: str,
    quality: MapQuality,
    evaluated: Sequence[EvaluatedPress],
    ball: Ball,
    circles: Mapping[str, Circle],
    facts: Mapping[str, Any],
) -> None:
    """Write and log the accuracy, and write contacts and a picture.

    Args:
        folder: Run folder.
        title: Description of the evaluation.
        quality: Accuracy of all presses together.
        evaluated: Evaluated presses.
        ball: Ball.
        circles: All contacts, including those of presses that the map was fitted to.
        facts: Additional entries of the JSON file.
    """
    single = {
        one.source.name: evaluate_map(one.map, [one.source.press], [one.circle], ball)
        for one in evaluated
    }
    radii = {one.source.name: one.circle.radius_px * ball.mm_per_px[0] for one in evaluated}
    table = _quality_table(quality, single, radii)
    note = (
        f"Slopes are compared at {quality.pixels} pixels within 0.9 of the contacts' radii;"
        " centers and radii were fitted to these presses. Depth is compared up to a constant."
    )
    presses = {n: {**asdict(q), "contact_radius_mm": radii[n]} for n, q in single.items()}
    figures = {"quality": asdict(quality), "presses": presses}
    write_json(folder / _REPORT, {"judged": title, **figures, **facts})
    with atomic_path(folder / _TEXT) as temporary:
        temporary.write_text(f"{title}\n{table.text()}\n{note}\n", encoding="utf-8")
    _write_circles(folder / _CIRCLES, circles)
    plot_ball_presses([_plotted(one, ball) for one in evaluated], ball, title, folder / _PICTURE)
    log_text(title, table, note)
    log.info("pictures of them: %s", folder / _PICTURE)


def _quality_table(
    quality: MapQuality, single: Mapping[str, MapQuality], radii_mm: Mapping[str, float]
) -> Table:
    head = ("", "R^2 x", "R^2 y", "MAE x", "MAE y", "depth rms, mm", "contact radius, mm")
    rows = []
    for name, q in [*single.items(), ("all together", quality)]:
        numbers = [f"{v:.3f}" for v in (*q.r2, *q.mae)]
        radius = f"{radii_mm[name]:.2f}" if name in radii_mm else ""
        rows.append((name, *numbers, f"{q.depth_rms_mm:.4f}", radius))
    return Table(head, rows)


def _write_circles(path: Path, circles: Mapping[str, Circle]) -> None:
    """Write contacts as a table that can be used as `labels`."""
    with atomic_path(path) as temporary, open(temporary, "w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file)
        rows.writerow(("image", "center_x_px", "center_y_px", "radius_px"))
        for name, circle in circles.items():
            rows.writerow((name, *(f"{v:.2f}" for v in (*circle.center_px, circle.radius_px))))


def _plotted(one: EvaluatedPress, ball: Ball) -> PlottedPress:
    press = one.source.press
    slopes = map_slopes(one.map, press.change)
    height = integrate_slopes(slopes[..., 0], slopes[..., 1], ball.mm_per_px)
    return PlottedPress(
        press.name, one.source.image, press.circle, one.circle, press.known, slopes, height
    )

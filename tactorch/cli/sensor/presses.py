"""Presses of a ball for `calibrate` and `check`: their images, and where the ball touches."""

import csv
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tactorch.cli.sensor.options import BallSettings
from tactorch.cli.settings import log
from tactorch.errors import FileError
from tactorch.files import atomic_path
from tactorch.sensor.calibration import (
    Ball,
    BallPress,
    Circle,
    find_circle,
    image_change,
    marker_pixels,
    read_labels,
)
from tactorch.sensor.description import SensorDescription
from tactorch.sensor.frames import Frame, Image, read_frames
from tactorch.sensor.markers import MarkerAppearance


class Pressed(NamedTuple):
    """A press with its image."""

    image: Image
    touch: BallPress


def presses_of(
    cfg: BallSettings,
    sensor: SensorDescription,
    ball: Ball,
    reference: Image,
    look: MarkerAppearance | None,
) -> list[Pressed]:
    """Read the presses; contacts are those of the labels, or are found.

    Raises:
        ConfigError: No ball is found in an image, or there is no image left.
        FileError: There are no images, or labels name others.
    """
    frames = _images(cfg, sensor, reference)
    labels = {} if cfg.labels is None else read_labels(str(cfg.labels))
    _check_labels(cfg, labels, frames)
    found = []
    for frame in frames:
        assert frame.image is not None
        changed = image_change(frame.image, reference, look)
        circle = labels.get(frame.name) or find_circle(changed, ball, frame.name)
        ball.check(circle, frame.name)
        known = ~marker_pixels(frame.image, reference, look)
        found.append(Pressed(frame.image, BallPress(frame.name, changed, known, circle)))
    told = len(labels.keys() & {frame.name for frame in frames})
    log.info("%d presses: %d contacts by labels, %d found", len(found), told, len(found) - told)
    return found


def write_circles(path: Path, circles: Mapping[str, Circle]) -> None:
    """Write contacts as a table that `labels` takes."""
    with atomic_path(path) as temporary, open(temporary, "w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file)
        rows.writerow(("image", "center_x_px", "center_y_px", "radius_px"))
        for name, circle in circles.items():
            rows.writerow((name, *(f"{v:.2f}" for v in (*circle.center_px, circle.radius_px))))


def _images(cfg: BallSettings, sensor: SensorDescription, reference: Image) -> list[Frame]:
    """Read the images that show a press: those that can be read, but for the reference."""
    kept, faulty = [], defaultdict(list)
    for frame in read_frames(cfg.images, sensor, reference):
        if frame.image is None or np.array_equal(frame.image, reference):
            reason = frame.fault or "it is the reference"
            log.info("%s is left out: %s", frame.name, reason)
            continue
        if frame.fault:
            faulty[frame.fault.split(":")[0]].append(frame.name)
        kept.append(frame)
    for fault, names in faulty.items():
        log.info("%d images are %s, the first %s; they are used", len(names), fault, names[0])
    if not kept:
        raise FileError(f"images '{cfg.images}' hold no press of the ball that can be read.")
    return kept


def _check_labels(cfg: BallSettings, labels: Mapping[str, Circle], frames: Sequence[Frame]) -> None:
    absent = sorted(labels.keys() - {frame.name for frame in frames})
    if absent:
        more = f" and {len(absent) - 1} more" if len(absent) > 1 else ""
        raise FileError(
            f"labels '{cfg.labels}' name '{absent[0]}'{more}, which images '{cfg.images}' do not"
            " hold, or which cannot be read."
        )

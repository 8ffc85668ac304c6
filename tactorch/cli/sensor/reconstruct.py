r"""`tactorch sensor reconstruct`: depth of the gel's surface in each frame.

    tactorch sensor reconstruct sensor=gelsight_mini calibration=calib.npz frames=press.avi \
      reference=still.png

The run folder gets heights/NUMBER.npz (height_mm, negative where pressed in, and contact),
depth.csv, summary.json and .txt, over_time.png, depth-NUMBER.png and depth.mp4.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from tactorch.cli.progress import progress
from tactorch.cli.sensor import film
from tactorch.cli.sensor.inputs import calibrated, reference_of
from tactorch.cli.sensor.options import ReconstructSettings
from tactorch.cli.sensor.sequence import (
    FrameSequence,
    caption_of,
    faults_of,
    faults_told,
    rate_of,
    times_of,
    without_image,
)
from tactorch.cli.sensor.tables import write_arrays, write_table
from tactorch.cli.settings import log, run_folder
from tactorch.sensor.calibration import Calibration
from tactorch.sensor.depth import reconstruct_height
from tactorch.sensor.description import SensorDescription
from tactorch.sensor.frames import Frame, Image
from tactorch.viz.sensor_frames import DepthView
from tactorch.viz.session import plot_over_time

_STEM = "depth"
_TABLE, _MAPS = "depth.csv", "heights"
_HEADER = ("frame", "time_s", "depth_mm", "contact_mm2", "fault")
_LEAST_MM = 0.02  # upper end of the colours where nothing is pressed


class Measured(NamedTuple):
    """What is told of a frame.

    Attributes:
        frame: Without its image.
        depth_mm: Of the deepest point; NaN where there is no image.
        contact_mm2: Area of the likely contact; NaN where there is no image.
    """

    frame: Frame
    depth_mm: float
    contact_mm2: float


def run(cfg: ReconstructSettings) -> Path:
    """Reconstruct depth; returns the folder of the maps."""
    place = run_folder()
    film.clear(place, _STEM, (_TABLE, f"{_MAPS}/*.npz"))
    sensor, calibration = calibrated(cfg)
    reference = reference_of(cfg.reference, cfg.reference_frames, sensor)
    frames = FrameSequence(cfg, sensor, reference)
    found = []
    with progress("reconstructing depth", "frames") as tell:
        for frame in frames:
            path = place / _MAPS / _name(frame)
            found.append(_measured(frame, calibration, reference, path, cfg))
            tell(len(found), frames.total)
    _write(place, found)
    _draw(place, cfg, sensor, frames, found)
    log.info("depth maps: %s", place / _MAPS)
    return place / _MAPS


def _name(frame: Frame) -> str:
    return f"{frame.index:05d}.npz"


def _measured(
    frame: Frame, calibration: Calibration, reference: Image, path: Path, cfg: ReconstructSettings
) -> Measured:
    """Reconstruct a frame and write its map."""
    if frame.image is None:
        return Measured(without_image(frame), float("nan"), float("nan"))
    slopes = calibration.slopes(frame.image, reference)
    height = reconstruct_height(slopes, calibration.mm_per_px, cfg.steep)
    deepest = -float(height.height_mm.min())
    contact = height.contact & (deepest >= cfg.min_depth_mm)
    write_arrays(
        path,
        height_mm=height.height_mm.astype(np.float32),
        contact=contact,
        mm_per_px=np.array(calibration.mm_per_px),
        time_s=frame.time_s,
    )
    area = float(contact.sum() * np.prod(calibration.mm_per_px))
    return Measured(without_image(frame), deepest, area)


def _write(place: Path, found: Sequence[Measured]) -> None:
    rows = [
        (one.frame.index, one.frame.time_s, one.depth_mm, one.contact_mm2, one.frame.fault)
        for one in found
    ]
    write_table(place / _TABLE, _HEADER, rows)
    known = [one.frame for one in found]
    touched = [one for one in found if one.contact_mm2 > 0]
    deepest = max((one.depth_mm for one in touched), default=0.0)
    values: dict[str, Any] = {
        "frames": len(found),
        "faulty": faults_of(known),
        "in_contact": len(touched),
        "deepest_mm": deepest,
    }
    lines = [
        f"{len(touched)} of {len(found)} frames are in contact, the deepest by {deepest:.3f} mm.",
        *faults_told(known),
    ]
    film.write_summary(place, values, lines)


def _draw(
    place: Path,
    cfg: ReconstructSettings,
    sensor: SensorDescription,
    frames: FrameSequence,
    found: Sequence[Measured],
) -> None:
    depth, area = (np.array([one[k] for one in found], dtype=float) for k in (1, 2))
    top = max(_LEAST_MM, float(np.nanmax(depth, initial=0.0)))
    view = DepthView(sensor, top)

    def show(frame: Frame) -> None:
        one = found[frame.index]
        told = f"{one.depth_mm:.3f} mm deep, contact {one.contact_mm2:.1f} mm²"
        caption = caption_of(one.frame, len(found), "no image" if frame.image is None else told)
        view.show(frame.image, *_map(place / _MAPS / _name(frame), sensor), caption)

    known = [one.frame for one in found]
    film.draw(place, _STEM, view, frames, show, cfg, known, rate_of(known))
    plot_over_time(
        {"depth, mm": {"deepest": depth}, "contact, mm²": {"contact": area}},
        times_of(known),
        [frame.index for frame in known if frame.fault],
        place / film.OVER_TIME,
    )


def _map(
    path: Path, sensor: SensorDescription
) -> tuple[Float[np.ndarray, "h w"], Bool[np.ndarray, "h w"]]:
    """Read a map; one of a frame without an image is not known."""
    if not path.is_file():
        return np.full(sensor.shape, np.nan), np.zeros(sensor.shape, dtype=bool)
    with np.load(path, allow_pickle=False) as found:
        return found["height_mm"].astype(float), found["contact"]

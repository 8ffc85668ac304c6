r"""`tactorch sensor reconstruct`: depth of the gel's surface in each frame.

    tactorch sensor reconstruct sensor=gelsight_mini calibration=calib.npz frames=press.avi \
      reference=still.png

The run folder gets heights/NUMBER.npz (height_mm, negative where pressed in, and contact),
depth.csv, summary.json and .txt, over_time.png, depth-NUMBER.png and depth.mp4.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from tactorch.cli.console import log
from tactorch.cli.sensor.frames import FrameSequence, RunFiles, caption, without_image
from tactorch.cli.sensor.inputs import load_calibrated, load_reference
from tactorch.cli.sensor.options import ReconstructSettings
from tactorch.sensor.calibration import Calibration
from tactorch.sensor.depth import reconstruct_height
from tactorch.sensor.description import SensorDescription
from tactorch.sensor.frames import Frame, Image
from tactorch.viz.sensor_frames import DepthView

_TABLE, _MAPS = "depth.csv", "heights"
_HEADER = ("frame", "time_s", "depth_mm", "contact_mm2", "fault")
_MIN_LIMIT_MM = 0.02  # of the color scale, for frames without contact


class _FrameDepth(NamedTuple):
    """Depth in a frame; NaN without an image.

    Attributes:
        frame: Frame without its image.
        depth_mm: Depth of the deepest point.
        contact_mm2: Area of the likely contact.
    """

    frame: Frame
    depth_mm: float
    contact_mm2: float


def run(cfg: ReconstructSettings) -> Path:
    """Reconstruct depth; returns the folder of the height maps."""
    files = RunFiles.prepare("depth", _TABLE, f"{_MAPS}/*.npz")
    sensor, calibration = load_calibrated(cfg)
    reference = load_reference(cfg.reference, cfg.reference_frames, sensor)
    frames = FrameSequence(cfg, sensor, reference)
    results = frames.process(
        "reconstructing depth",
        lambda frame: _frame_depth(frame, calibration, reference, files, cfg),
    )
    _write(files, results)
    _draw(files, cfg, sensor, frames, results)
    log.info("depth maps: %s", files.folder / _MAPS)
    return files.folder / _MAPS


def _map_name(frame: Frame) -> str:
    return f"{_MAPS}/{frame.index:05d}.npz"


def _frame_depth(
    frame: Frame,
    calibration: Calibration,
    reference: Image,
    files: RunFiles,
    cfg: ReconstructSettings,
) -> _FrameDepth:
    """Reconstruct a frame and write its height map."""
    if frame.image is None:
        return _FrameDepth(without_image(frame), float("nan"), float("nan"))
    slopes = calibration.slopes(frame.image, reference)
    height = reconstruct_height(slopes, calibration.mm_per_px, cfg.min_slope)
    contact = height.contact & (height.depth_mm >= cfg.min_depth_mm)
    files.write_arrays(
        _map_name(frame),
        height_mm=height.height_mm.astype(np.float32),
        contact=contact,
        mm_per_px=np.array(calibration.mm_per_px),
        time_s=frame.time_s,
    )
    area = float(contact.sum() * np.prod(calibration.mm_per_px))
    return _FrameDepth(without_image(frame), height.depth_mm, area)


def _write(files: RunFiles, results: list[_FrameDepth]) -> None:
    rows = [(r.frame.index, r.frame.time_s, *r[1:], r.frame.fault) for r in results]
    files.write_table(_TABLE, _HEADER, rows)
    depths = [result.depth_mm for result in results if result.contact_mm2 > 0]
    deepest = max(depths, default=0.0)
    files.write_frame_summary(
        [result.frame for result in results],
        {"in_contact": len(depths), "deepest_mm": deepest},
        [
            f"{len(depths)} of {len(results)} frames are in contact, the deepest by"
            f" {deepest:.3f} mm."
        ],
    )


def _draw(
    files: RunFiles,
    cfg: ReconstructSettings,
    sensor: SensorDescription,
    frames: FrameSequence,
    results: list[_FrameDepth],
) -> None:
    depth, area = (np.array([result[k] for result in results], dtype=float) for k in (1, 2))
    view = DepthView(sensor, max(_MIN_LIMIT_MM, float(np.nanmax(depth, initial=0.0))))

    def show(frame: Frame) -> None:
        result = results[frame.index]
        text = f"{result.depth_mm:.3f} mm deep, contact {result.contact_mm2:.1f} mm²"
        text = caption(result.frame, len(results), "no image" if frame.image is None else text)
        view.show(frame.image, *_read_map(files.folder / _map_name(frame), sensor), text)

    series = {"depth, mm": {"deepest": depth}, "contact, mm²": {"contact": area}}
    files.draw(view, frames, show, cfg, [result.frame for result in results], series)


def _read_map(
    path: Path, sensor: SensorDescription
) -> tuple[Float[np.ndarray, "h w"], Bool[np.ndarray, "h w"]]:
    """Read a height map; NaN for a frame without an image."""
    if not path.is_file():
        return np.full(sensor.shape, np.nan), np.zeros(sensor.shape, dtype=bool)
    with np.load(path, allow_pickle=False) as archive:
        return archive["height_mm"].astype(float), archive["contact"]

r"""`tactorch sensor reconstruct`: depth of the gel's surface in each frame.

    tactorch sensor reconstruct sensor=gelsight_mini calibration=calib.npz frames=press.avi \
      reference=still.png

The run folder gets heights/NUMBER.npz (height_mm, negative where pressed in, and contact),
depth.csv, summary.json and .txt, over_time.png, depth-NUMBER.png and depth.mp4.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from tactorch.cli.console import log
from tactorch.cli.sensor.frames import RunFiles, caption, without_image
from tactorch.cli.sensor.inputs import FrameSequence, load_calibrated
from tactorch.cli.sensor.options import ReconstructSettings
from tactorch.files import write_arrays
from tactorch.sensor.description import SensorDescription
from tactorch.sensor.frames import Frame
from tactorch.viz.sensor_frames import DepthView

_TABLE, _MAPS = "depth.csv", "heights"
_MIN_LIMIT_MM = 0.02  # of the color scale, for frames without contact


def run(cfg: ReconstructSettings) -> Path:
    """Reconstruct depth; returns the folder of the height maps."""
    files = RunFiles("depth", _TABLE, f"{_MAPS}/*.npz")
    sensor, calibration = load_calibrated(cfg)
    frames, pixel_mm2 = FrameSequence(cfg, sensor), float(np.prod(calibration.mm_per_px))
    changed: list[bool] = []

    def reconstruct(frame: Frame) -> tuple[Frame, float, float, float, float]:
        """Write the height map.

        Returns:
            The frame, its depth, mm, contact area, mm^2, relative light, and the depth's standard
            deviation from a change of the light, mm.
        """
        if frame.image is None:
            nan = float("nan")
            return without_image(frame), nan, nan, nan, nan
        height = calibration.height(
            frame.image, frames.reference, depth=cfg.depth, min_slope=cfg.min_slope
        )
        contact = height.contact & (height.depth_mm >= cfg.min_depth_mm)
        arrays = {"height_mm": height.height_mm.astype(np.float32), "contact": contact}
        arrays["mm_per_px"] = np.array(calibration.mm_per_px)
        if frame.time_s is not None:
            arrays["time_s"] = np.array(frame.time_s)
        write_arrays(files.folder / _map_name(frame), arrays, compressed=True)
        light = height.light
        assert light is not None
        changed.append(light.changed)
        area, depth = float(contact.sum() * pixel_mm2), height.depth_mm
        stored = without_image(frame, light.fault)
        return stored, depth, area, light.factor, height.light_error_mm

    results = frames.process("reconstructing depth", reconstruct)
    measured, *columns = map(list, zip(*results, strict=True))
    all_depths, areas, light, errors = (np.array(column, dtype=float) for column in columns)
    files.write_frame_table(
        _TABLE, measured, depth_mm=all_depths, contact_mm2=areas, light=light, light_error_mm=errors
    )
    depths = all_depths[areas > 0].tolist()
    deepest = max(depths, default=0.0)
    files.write_frame_summary(
        measured,
        {"in_contact": len(depths), "deepest_mm": deepest, "light_changed": sum(changed)},
        f"{len(depths)} of {len(results)} frames are in contact, the deepest by {deepest:.3f} mm.",
        *_light_line(light, changed),
    )
    view = DepthView(sensor, max(_MIN_LIMIT_MM, float(np.nanmax(all_depths, initial=0.0))))

    def show(frame: Frame) -> None:
        stored, depth, area, *_ = results[frame.index]
        text = f"{depth:.3f} mm deep, contact {area:.1f} mm²"
        text = caption(stored, len(results), "no image" if frame.image is None else text)
        view.show(frame.image, *_read_map(files.folder / _map_name(frame), sensor), text)

    series = {"depth, mm": {"deepest": all_depths}, "contact, mm²": {"contact": areas}}
    files.draw(view.figure, frames, show, cfg, measured, series)
    log.info("depth maps: %s", files.folder / _MAPS)
    return files.folder / _MAPS


def _light_line(light: Float[np.ndarray, " f"], changed: list[bool]) -> list[str]:
    if not any(changed):
        return []
    return [
        f"The light differs from that of the reference in {sum(changed)} frames: it is"
        f" {np.nanmin(light):.2f} to {np.nanmax(light):.2f} of it on average over the colors. This"
        " is corrected; its error is in the column light_error_mm."
    ]


def _map_name(frame: Frame) -> str:
    return f"{_MAPS}/{frame.index:05d}.npz"


def _read_map(
    path: Path, sensor: SensorDescription
) -> tuple[Float[np.ndarray, "h w"], Bool[np.ndarray, "h w"]]:
    """Read a height map; NaN for a frame without an image."""
    if not path.is_file():
        return np.full(sensor.shape, np.nan), np.zeros(sensor.shape, dtype=bool)
    with np.load(path, allow_pickle=False) as archive:
        return archive["height_mm"].astype(float), archive["contact"]

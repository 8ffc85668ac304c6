"""`tactorch sensor track`: follow the markers through frames.

    tactorch sensor track sensor=gelsight_markers frames=press.avi reference=still.png
    tactorch sensor track ... reference=press.avi reference_frames=10 backward=true
    tactorch sensor track ... frames=0 max_frames=300              a camera

The run folder gets tracks.csv and .npz, summary.json and .txt (with the faulty frames),
over_time.png, markers-NUMBER.png and markers.mp4.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from tactorch.cli.console import log, progress
from tactorch.cli.sensor.frames import RunFiles, caption, without_image, write_table
from tactorch.cli.sensor.inputs import FrameSequence, load_sensor_settings
from tactorch.cli.sensor.options import TrackSettings
from tactorch.errors import ConfigError
from tactorch.sensor.frames import Frame
from tactorch.sensor.markers import (
    MarkerAppearance,
    MarkerTracker,
    marker_appearance,
    marker_displacements,
)
from tactorch.viz.sensor_frames import MarkerView, colour_limit

_TABLE, _ARRAYS = "tracks.csv", "tracks.npz"
_HEADER = (
    "frame", "image", "time_s", "marker", "x_px", "y_px", "dx_mm", "dy_mm", "valid", "fault",
)  # fmt: skip
_MIN_LIMIT_MM = 0.05  # of the color scale, for frames without motion
_MATCH_PX = 2.0  # between a tracked marker and the marker detected in the last frame

Positions = Float[np.ndarray, "f n 2"]


def run(cfg: TrackSettings) -> Path:
    """Track markers; returns the path of the table."""
    files = RunFiles("markers", _TABLE, _ARRAYS)
    sensor = load_sensor_settings(cfg)
    appearance = marker_appearance(sensor, cfg.marker_diameter_px)
    if appearance is None:
        raise ConfigError(
            f"sensor '{sensor.name}' has no markers; describe them in its file, or give"
            " marker_diameter_px."
        )
    frames = FrameSequence(cfg, sensor)
    tracker = MarkerTracker(frames.reference, appearance)
    reassigned, covered = list[bool](), list[int]()

    def track(frame: Frame) -> tuple[Frame, np.ndarray, np.ndarray]:
        positions_px = tracker.track(frame.image)
        _, displacement = marker_displacements(sensor, tracker.reference_px, positions_px)
        reassigned.append(frame.image is not None and tracker.reassigned)
        covered.append(int(tracker.covered.sum()))
        return without_image(frame, tracker.fault), positions_px, displacement[:, :2]

    results = frames.process("following markers", track)
    measured, *arrays = map(list, zip(*results, strict=True))
    positions, displacements = map(np.stack, arrays)
    valid = np.isfinite(positions[..., 0])
    _write(files, tracker.reference_px, measured, positions, displacements, valid)
    size = np.where(valid, np.linalg.norm(displacements, axis=2), np.nan)
    values, *lines = _summarize(size, valid)
    values["reassigned_frames"] = np.flatnonzero(reassigned).tolist()
    if any(reassigned):
        lines.append(
            f"After jumps, the markers of {sum(reassigned)} frames were assigned from the reference"
            " alone."
        )
    values |= {"covered": covered, "left_out_of_reference": tracker.left_out}
    if tracker.left_out:
        lines.append(
            f"{tracker.left_out} spots of the reference are left out: they are no whole markers."
            " Clean the gel and the camera's window."
        )
    if cfg.backward:
        values["backward"], line = _track_back(frames, positions, appearance)
        lines.append(line)
    files.write_frame_summary(measured, values, *lines)
    limit_mm = colour_limit(size, _MIN_LIMIT_MM)
    view = MarkerView(sensor, tracker.reference_px, limit_mm, cfg.magnify)

    def show(frame: Frame) -> None:
        k = frame.index
        text = f"{int(valid[k].sum())} of {valid.shape[1]} markers"
        if valid[k].any():
            text += f", up to {np.nanmax(size[k]):.2f} mm"
        view.show(frame.image, positions[k], caption(measured[k], len(measured), text))

    tracked = [row[np.isfinite(row)] for row in size]
    largest, median = (
        np.array([float(statistic(row)) if len(row) else np.nan for row in tracked])
        for statistic in (np.max, np.median)
    )
    series = {
        "displacement, mm": {"largest": largest, "median": median},
        "markers detected": {"detected": valid.sum(axis=1).astype(float)},
    }
    files.draw(view.figure, frames, show, cfg, measured, series)
    log.info("tracks: %s", files.folder / _TABLE)
    return files.folder / _TABLE


def _write(
    files: RunFiles,
    reference_px: Float[np.ndarray, "n 2"],
    frames: Sequence[Frame],
    positions: Positions,
    displacements: Positions,
    valid: Bool[np.ndarray, "f n"],
) -> None:
    numbers = np.concatenate([positions, displacements], axis=2).tolist()
    rows = (
        (f.index, f.name, f.time_s, marker, *numbers[k][marker], int(is_valid), f.fault)
        for k, f in enumerate(frames)
        for marker, is_valid in enumerate(valid[k])
    )
    write_table(files.folder / _TABLE, _HEADER, rows)
    arrays = {"begin_px": reference_px, "places_px": positions, "displacement_mm": displacements}
    files.write_frame_arrays(_ARRAYS, frames, **arrays, valid=valid)


def _summarize(size: np.ndarray, valid: Bool[np.ndarray, "f n"]) -> tuple[dict[str, Any], str]:
    (n_frames, n_markers), readable = valid.shape, valid[valid.any(axis=1)]
    always = int(readable.all(axis=0).sum()) if len(readable) else 0
    largest = float(np.nanmax(size)) if valid.any() else float("nan")
    share = float(valid.mean())
    values = {"markers": n_markers, "seen_share": share, "seen_in_all_readable_frames": always}
    return values | {"largest_displacement_mm": largest}, (
        f"{n_markers} markers in {n_frames} frames: detected in {share:.1%} of cases,"
        f" {always} of them in every frame that can be read; largest displacement {largest:.3g} mm."
    )


def _track_back(
    frames: FrameSequence, positions: Positions, appearance: MarkerAppearance
) -> tuple[dict[str, Any], str]:
    """Track the markers of the last frame back to the first, and compare with their start."""
    none_found = "Tracked back, no marker is found in the first frame."
    readable = [(k, frame.image) for k, frame in enumerate(frames) if frame.image is not None]
    if len(readable) < 2:
        return {"markers": 0}, none_found
    numbers, images = [k for k, _ in readable], [image for _, image in readable]
    tracker = MarkerTracker(images[-1], appearance)
    ends = tracker.reference_px
    with progress("following them back", "frames") as report:
        for done, image in enumerate(images[-2::-1], 1):
            ends = tracker.track(image)
            report(done, len(images) - 1)
    first, last = positions[numbers[0]], positions[numbers[-1]]
    valid = np.isfinite(first[:, 0]) & np.isfinite(last[:, 0])
    distance, match = cKDTree(tracker.reference_px).query(np.nan_to_num(last, nan=-1e6))
    matched = valid & (distance < _MATCH_PX)
    errors = np.linalg.norm(ends[match[matched]] - first[matched], axis=1)
    errors = errors[np.isfinite(errors)]
    values: dict[str, Any] = {"markers": len(errors), "seen_at_both_ends": int(valid.sum())}
    if not len(errors):
        return values | dict.fromkeys(("median_px", "largest_px", "under_half_px")), none_found
    values["median_px"], values["largest_px"] = float(np.median(errors)), float(errors.max())
    values["under_half_px"] = float((errors < 0.5).mean())
    return values, (
        f"Tracked back from the last frame, {values['markers']} of the"
        f" {values['seen_at_both_ends']} markers detected at both ends are found in the first:"
        f" {values['median_px']:.2f} px from their start in the median,"
        f" {values['largest_px']:.2f} px at most, {values['under_half_px']:.1%} within 0.5 px."
    )

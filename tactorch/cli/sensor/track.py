"""`tactorch sensor track`: follow the markers through frames.

    tactorch sensor track sensor=gelsight_markers frames=press.avi reference=still.png
    tactorch sensor track ... reference=press.avi reference_frames=10 backward=true
    tactorch sensor track ... frames=0 max_frames=300              a camera

The run folder gets tracks.csv and .npz, summary.json and .txt (with the faulty frames),
over_time.png, markers-NUMBER.png and markers.mp4.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from tactorch.cli.progress import progress
from tactorch.cli.sensor import film
from tactorch.cli.sensor.inputs import look_of, reference_of, sensor_of
from tactorch.cli.sensor.options import TrackSettings
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
from tactorch.errors import ConfigError
from tactorch.sensor.description import SensorDescription
from tactorch.sensor.frames import Frame, Image
from tactorch.sensor.markers import MarkerAppearance, MarkerTracker, marker_displacements
from tactorch.viz.sensor_frames import MarkerView, colour_limit
from tactorch.viz.session import plot_over_time

_STEM = "markers"
_TABLE, _ARRAYS = "tracks.csv", "tracks.npz"
_HEADER = ("frame", "time_s", "marker", "x_px", "y_px", "dx_mm", "dy_mm", "valid", "fault")
_LEAST_MM = 0.05  # upper end of the colours where nothing moves
_SAME_PX = 2.0  # between a marker followed there and the one found there

Places = Float[np.ndarray, "f n 2"]


def run(cfg: TrackSettings) -> Path:
    """Follow markers; returns the path of the table."""
    place = run_folder()
    film.clear(place, _STEM, (_TABLE, _ARRAYS))
    sensor = sensor_of(cfg)
    look = look_of(sensor, cfg.marker_diameter_px)
    if look is None:
        raise ConfigError(
            f"sensor '{sensor.name}' has no markers; describe them in its file, or give"
            " marker_diameter_px."
        )
    reference = reference_of(cfg.reference, cfg.reference_frames, sensor)
    tracker, frames = MarkerTracker(reference, look), FrameSequence(cfg, sensor, reference)
    known, places = _followed(tracker, frames)
    moved = np.stack(
        [marker_displacements(sensor, tracker.reference_px, one)[1][:, :2] for one in places]
    )
    _write(place, tracker.reference_px, known, places, moved)
    values, lines = _summary(known, places, moved)
    if cfg.backward:
        values["backward"] = _backward(frames, places, look)
        lines.append(_backward_told(values["backward"]))
    film.write_summary(place, values, lines)
    _draw(place, cfg, sensor, tracker, frames, known, places, moved)
    log.info("tracks: %s", place / _TABLE)
    return place / _TABLE


def _followed(tracker: MarkerTracker, frames: FrameSequence) -> tuple[list[Frame], Places]:
    known, places = [], []
    with progress("following markers", "frames") as tell:
        for frame in frames:
            none = np.full(tracker.reference_px.shape, np.nan)
            places.append(none if frame.image is None else tracker.track(frame.image))
            known.append(without_image(frame))
            tell(len(known), frames.total)
    return known, np.stack(places)


def _write(
    place: Path,
    begin: Float[np.ndarray, "n 2"],
    known: Sequence[Frame],
    places: Places,
    moved: Places,
) -> None:
    def rows() -> Iterator[tuple[Any, ...]]:
        for frame, now, went in zip(known, places, moved, strict=True):
            for marker in range(len(begin)):
                valid = int(np.isfinite(now[marker, 0]))
                numbers = [float(v) for v in (*now[marker], *went[marker])]
                yield (frame.index, frame.time_s, marker, *numbers, valid, frame.fault)

    write_table(place / _TABLE, _HEADER, rows())
    write_arrays(
        place / _ARRAYS,
        begin_px=begin,
        places_px=places,
        displacement_mm=moved,
        valid=np.isfinite(places[..., 0]),
        time_s=times_of(known),
        fault=np.array([frame.fault for frame in known]),
    )


def _summary(
    known: Sequence[Frame], places: Places, moved: Places
) -> tuple[dict[str, Any], list[str]]:
    seen, size = np.isfinite(places[..., 0]), np.linalg.norm(moved, axis=2)
    readable = seen.any(axis=1)
    always = int(seen[readable].all(axis=0).sum()) if readable.any() else 0
    most = float(np.nanmax(size)) if seen.any() else float("nan")
    values: dict[str, Any] = {
        "frames": len(known),
        "faulty": faults_of(known),
        "markers": places.shape[1],
        "seen_share": float(seen.mean()),
        "seen_in_all_readable_frames": always,
        "largest_displacement_mm": most,
    }
    lines = [
        f"{places.shape[1]} markers in {len(known)} frames: seen in {seen.mean():.1%} of cases,"
        f" {always} of them in every frame that can be read; largest displacement {most:.3g} mm.",
        *faults_told(known),
    ]
    return values, lines


def _backward(frames: FrameSequence, places: Places, look: MarkerAppearance) -> dict[str, Any]:
    """Follow the markers of the last frame back to the first; tell where they come out."""
    pairs = [(k, frame.image) for k, frame in enumerate(frames) if frame.image is not None]
    if len(pairs) < 2:
        return {"markers": 0}
    numbers, images = [k for k, _ in pairs], [image for _, image in pairs]
    tracker = MarkerTracker(images[-1], look)
    found = _to_the_first(tracker, images)
    first, last = places[numbers[0]], places[numbers[-1]]
    ends = np.isfinite(first[:, 0]) & np.isfinite(last[:, 0])
    distance, twin = cKDTree(tracker.reference_px).query(np.nan_to_num(last, nan=-1e6))
    same = ends & (distance < _SAME_PX)
    off = np.linalg.norm(found[twin[same]] - first[same], axis=1)
    told = off[np.isfinite(off)]
    return {
        "markers": len(told),
        "seen_at_both_ends": int(ends.sum()),
        "median_px": float(np.median(told)) if len(told) else None,
        "largest_px": float(told.max()) if len(told) else None,
        "under_half_px": float((told < 0.5).mean()) if len(told) else None,
    }


def _to_the_first(tracker: MarkerTracker, images: Sequence[Image]) -> Float[np.ndarray, "n 2"]:
    places = tracker.reference_px
    with progress("following them back", "frames") as tell:
        for done, image in enumerate(images[-2::-1], 1):
            places = tracker.track(image)
            tell(done, len(images) - 1)
    return places


def _backward_told(values: dict[str, Any]) -> str:
    if not values["markers"]:
        return "Followed back, no marker came out in the first frame."
    return (
        f"Followed back from the last frame, {values['markers']} of the"
        f" {values['seen_at_both_ends']} markers seen at both ends come out in the first:"
        f" {values['median_px']:.2f} px from where they began in the median,"
        f" {values['largest_px']:.2f} px at most, {values['under_half_px']:.1%} within 0.5 px."
    )


def _draw(
    place: Path,
    cfg: TrackSettings,
    sensor: SensorDescription,
    tracker: MarkerTracker,
    frames: FrameSequence,
    known: Sequence[Frame],
    places: Places,
    moved: Places,
) -> None:
    size, seen = np.linalg.norm(moved, axis=2), np.isfinite(places[..., 0])
    view = MarkerView(
        sensor, tracker.reference_px, colour_limit(size, _LEAST_MM), float(cfg.magnify)
    )

    def show(frame: Frame) -> None:
        k = frame.index
        told = f"{int(seen[k].sum())} of {seen.shape[1]} markers"
        if seen[k].any():
            told += f", up to {np.nanmax(size[k]):.2f} mm"
        view.show(frame.image, places[k], caption_of(known[k], len(known), told))

    film.draw(place, _STEM, view, frames, show, cfg, known, rate_of(known))
    some = [row[valid] for row, valid in zip(size, seen, strict=True)]
    most, middle = (
        np.array([float(of(row)) if len(row) else np.nan for row in some])
        for of in (np.max, np.median)
    )
    plot_over_time(
        {
            "displacement, mm": {"largest": most, "median": middle},
            "markers seen": {"seen": seen.sum(axis=1).astype(float)},
        },
        times_of(known),
        [frame.index for frame in known if frame.fault],
        place / film.OVER_TIME,
    )

"""Frames of a command, and its files: tables, arrays, summary, plots, pictures and video."""

import csv
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol, TypeVar, cast, runtime_checkable

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from tactorch.cli.console import log, progress
from tactorch.cli.outputs import write_json
from tactorch.cli.sensor.options import PictureSettings, SequenceSettings
from tactorch.cli.settings import run_folder
from tactorch.errors import ConfigError
from tactorch.files import atomic_path
from tactorch.sensor.description import SensorDescription
from tactorch.sensor.frames import (
    IMAGE_SUFFIXES,
    VIDEO_SUFFIXES,
    Frame,
    Image,
    read_frames,
    video_length,
)
from tactorch.viz.figure import save_figure
from tactorch.viz.sensor_frames import DPI, render
from tactorch.viz.session import plot_over_time
from tactorch.viz.video import video_suffix, writing_video

_T = TypeVar("_T")
_DEFAULT_RATE_HZ = 10.0  # of a video of frames without times
_MAX_LISTED = 20  # faulty frames in a text
_MAX_FAULT_CHARACTERS = 70  # in a caption
_SUMMARY, _TEXT, OVER_TIME = "summary.json", "summary.txt", "over_time.png"


class FrameSequence:
    """Frames of a folder, a video, an image or a camera; those of a camera are stored.

    Args:
        cfg: Settings with `frames` and `max_frames`.
        sensor: Sensor that takes the frames.
        reference: Image of the gel without contact.
        once: Whether to iterate only once; a camera may then run without end.

    Attributes:
        zero_unix_s: Time of a camera's first frame, seconds since 1970; None before.

    Raises:
        ConfigError: A camera without `max_frames`.
        FileError: The source does not exist or has no frames.
    """

    def __init__(
        self,
        cfg: SequenceSettings,
        sensor: SensorDescription,
        reference: Image,
        *,
        once: bool = False,
    ) -> None:
        self.source, self.max_frames = cfg.frames, cfg.max_frames
        self._sensor, self._reference, self._once = sensor, reference, once
        if self.is_camera and self.max_frames is None and not once:
            raise ConfigError(f"frames={self.source} is a camera; give max_frames too.")
        self._stored: list[Frame] | None = None
        self.zero_unix_s: float | None = None
        self._first = self._read()  # a missing source is an error at once

    def __iter__(self) -> Iterator[Frame]:
        """Iterate over the frames from the first."""
        if self._once:
            return self._first
        if not self.is_camera:
            return self._read()
        return self._store() if self._stored is None else iter(self._stored)

    @property
    def is_camera(self) -> bool:
        """Whether the source is a camera."""
        return isinstance(self.source, int)

    @property
    def total(self) -> int:
        """Expected number of frames."""
        if isinstance(self.source, int):
            return self.max_frames or 1
        count = 1
        if self.source.is_dir():
            count = sum(p.suffix.lower() in IMAGE_SUFFIXES for p in self.source.iterdir())
        elif self.source.suffix.lower() in VIDEO_SUFFIXES:
            count = video_length(self.source)
        return count if self.max_frames is None else min(count, self.max_frames)

    def process(self, label: str, function: Callable[[Frame], _T]) -> list[_T]:
        """Apply a function to all frames, with a progress bar."""
        results: list[_T] = []
        with progress(label, "frames") as report:
            for frame in self:
                results.append(function(frame))
                report(len(results), self.total)
        return results

    def _read(self) -> Iterator[Frame]:
        return self._limited(read_frames(self.source, self._sensor, self._reference))

    def _limited(self, frames: Iterator[Frame]) -> Iterator[Frame]:
        for count, frame in enumerate(frames, start=1):
            if self.zero_unix_s is None and None not in (frame.unix_s, frame.time_s):
                self.zero_unix_s = cast(float, frame.unix_s) - cast(float, frame.time_s)
            yield frame
            if count == self.max_frames:
                return

    def _store(self) -> Iterator[Frame]:
        frames = []
        for frame in self._first:
            frames.append(frame)
            yield frame
        self._stored = frames


def without_image(frame: Frame, fault: str = "") -> Frame:
    """Return a frame without its image and with an additional fault."""
    faults = "; ".join(part for part in (frame.fault, fault) if part)
    return replace(frame, image=None, fault=faults)


def frame_times(frames: Sequence[Frame]) -> Float[np.ndarray, " f"] | None:
    """Return the times of frames, s; None if some are unknown."""
    times = [frame.time_s for frame in frames if frame.time_s is not None]
    return np.array(times) if len(times) == len(frames) else None


def caption(frame: Frame, total: int, text: str) -> str:
    """Return the two lines above a picture of a frame."""
    time = "" if frame.time_s is None else f", {frame.time_s:.2f} s"
    fault = frame.fault
    if len(fault) >= _MAX_FAULT_CHARACTERS:
        fault = f"{fault[: _MAX_FAULT_CHARACTERS - 3]}..."
    return f"frame {frame.index} of {total}{time}: {text}\n{fault or ' '}"


@runtime_checkable
class View(Protocol):
    """Figure that is updated for each frame."""

    figure: Figure


@dataclass(frozen=True)
class RunFiles:
    """Files of a command in its run folder. Files of an earlier run are removed.

    Attributes:
        stem: Start of the names of pictures and video.
        others: Names or patterns of the command's other files.
        folder: Run folder.
    """

    stem: str
    others: Sequence[str]
    folder: Path

    @staticmethod
    def prepare(stem: str, *others: str) -> "RunFiles":
        """Remove the files of an earlier run in the run folder."""
        folder = run_folder()
        pictures = (f"{stem}-*.png", f"{stem}.mp4", f"{stem}.avi")
        for pattern in (_SUMMARY, _TEXT, OVER_TIME, *pictures, *others):
            for path in folder.glob(pattern):
                path.unlink()
        return RunFiles(stem, others, folder)

    def write_table(self, name: str, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> Path:
        """Write a CSV file; None and NaN are left empty."""
        path = self.folder / name
        with (
            atomic_path(path) as temporary,
            open(temporary, "w", newline="", encoding="utf-8") as file,
        ):
            table = csv.writer(file)
            table.writerow(header)
            table.writerows([_cell(value) for value in row] for row in rows)
        return path

    def write_arrays(self, name: str, **arrays: Any) -> None:
        """Write an npz file; arrays that are None are left out."""
        present = {key: values for key, values in arrays.items() if values is not None}
        with atomic_path(self.folder / name) as temporary, open(temporary, "wb") as file:
            np.savez_compressed(file, **present)

    def write_frame_summary(
        self, frames: Sequence[Frame], values: Mapping[str, Any], lines: Sequence[str]
    ) -> None:
        """Write and log a summary, including the faulty frames."""
        faulty = [frame for frame in frames if frame.fault]
        listed = [f"  {frame.name}: {frame.fault}" for frame in faulty[:_MAX_LISTED]]
        if len(faulty) > _MAX_LISTED:
            listed.append(f"  and {len(faulty) - _MAX_LISTED} more")
        count = f"{len(faulty)} of {len(frames)} frames are faulty" + (":" if faulty else ".")
        table = [{"frame": f.index, "name": f.name, "fault": f.fault} for f in faulty]
        first, *more = lines
        self.write_summary(
            {"frames": len(frames), "faulty": table, **values}, [first, count, *listed, *more]
        )

    def write_summary(self, values: Mapping[str, Any], lines: Sequence[str]) -> None:
        """Write a summary as JSON and as text, and log the text."""
        write_json(self.folder / _SUMMARY, values)
        text = "\n".join(lines)
        with atomic_path(self.folder / _TEXT) as temporary:
            temporary.write_text(text + "\n", encoding="utf-8")
        log.info("%s", text)

    def draw(
        self,
        view: View,
        frames: FrameSequence,
        show: Callable[[Frame], None],
        cfg: PictureSettings,
        measured: Sequence[Frame],
        series: Mapping[str, Mapping[str, np.ndarray]],
    ) -> None:
        """Draw pictures of some frames, evenly spaced, a video of all, and a plot over time.

        Args:
            view: Figure.
            frames: Frames.
            show: Function that updates the figure for a frame.
            cfg: Settings with `pictures` and `video`.
            measured: Frames as they were measured.
            series: Curves over time, by label of the axes and by name.
        """
        total, times = len(measured), frame_times(measured)
        indices = np.linspace(0, total - 1, min(cfg.pictures, total)).round().astype(int)
        selected = set(indices.tolist())
        suffix = video_suffix() if cfg.video and total > 1 else None
        if cfg.video and total > 1 and suffix is None:
            log.info("no video: this OpenCV can write neither MPEG-4 nor Motion JPEG.")
        with ExitStack() as stack:
            path = self.folder / f"{self.stem}{suffix}"
            rate_hz = _frame_rate(times)
            add = stack.enter_context(writing_video(path, rate_hz)) if suffix else None
            report = stack.enter_context(progress("drawing", "frames"))
            for number, frame in enumerate(frames):
                if add is not None or number in selected:
                    show(frame)
                if add is not None:
                    add(render(view.figure))
                if number in selected:
                    picture = self.folder / f"{self.stem}-{frame.index:04d}.png"
                    save_figure(view.figure, picture, DPI)
                report(number + 1, total)
        log.info("pictures%s: %s", " and video" if suffix else "", self.folder)
        faulty = [frame.index for frame in measured if frame.fault]
        plot_over_time(series, times, faulty, self.folder / OVER_TIME)


def _frame_rate(times: Float[np.ndarray, " f"] | None) -> float:
    if times is None or len(times) < 2:
        return _DEFAULT_RATE_HZ
    period = float(np.median(np.diff(times)))
    return 1.0 / period if period > 0 else _DEFAULT_RATE_HZ


def _cell(value: Any) -> Any:
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ""
    return f"{value:.6g}" if isinstance(value, float) else value

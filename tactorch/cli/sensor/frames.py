"""Files of a command that processes frames: tables, arrays, summary, plots, pictures and video."""

import csv
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from tactorch.cli.console import log, progress
from tactorch.cli.sensor.inputs import FrameSequence
from tactorch.cli.sensor.options import PictureSettings
from tactorch.cli.settings import run_folder
from tactorch.files import atomic_path, write_arrays, write_file, write_json
from tactorch.sensor.frames import Frame
from tactorch.text import one_line
from tactorch.viz.figure import save_figure
from tactorch.viz.sensor_frames import DPI, render
from tactorch.viz.session import over_time_figure
from tactorch.viz.video import video_suffix, writing_video

_DEFAULT_RATE_HZ = 10.0  # of a video of frames without times
_MAX_LISTED = 20  # faulty frames in a text
_MAX_FAULT_CHARACTERS = 70  # in a caption
_SUMMARY, _TEXT, OVER_TIME = "summary.json", "summary.txt", "over_time.png"


def without_image(frame: Frame, fault: str = "") -> Frame:
    """Return a frame without its image and with an additional fault."""
    return replace(frame.with_faults(fault), image=None)


def _frame_times(frames: Sequence[Frame]) -> Float[np.ndarray, " f"] | None:
    """Times of frames, s; None if some are unknown."""
    times = [frame.time_s for frame in frames if frame.time_s is not None]
    return np.array(times) if len(times) == len(frames) else None


def caption(frame: Frame, total: int, text: str) -> str:
    """Return the two lines above a picture of a frame."""
    time = "" if frame.time_s is None else f", {frame.time_s:.2f} s"
    fault = one_line(frame.fault, _MAX_FAULT_CHARACTERS) or " "
    return f"frame {frame.index} of {total}{time}: {text}\n{fault}"


def write_table(path: Path, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Write a CSV file; None and NaN are left empty."""
    with atomic_path(path) as temporary, open(temporary, "w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(header)
        table.writerows([_cell(value) for value in row] for row in rows)


def _cell(value: Any) -> Any:
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ""
    return f"{value:.6g}" if isinstance(value, float) else value


def clean_run_folder(*patterns: str) -> Path:
    """Return the run folder, without the files of an earlier run."""
    folder = run_folder()
    for pattern in patterns:
        for path in folder.glob(pattern):
            path.unlink()
    return folder


class RunFiles:
    """Files of a command in its run folder; those of an earlier run are removed.

    Names of pictures and video start with `stem`; `others` are patterns of its other files.
    """

    def __init__(self, stem: str, *others: str) -> None:
        pictures = (f"{stem}-*.png", f"{stem}.mp4", f"{stem}.avi")
        self.stem = stem
        self.folder = clean_run_folder(_SUMMARY, _TEXT, OVER_TIME, *pictures, *others)

    def write_frame_table(
        self, name: str, frames: Sequence[Frame], **columns: Iterable[Any]
    ) -> None:
        """Write a CSV file with a line for each frame: these columns, and what it is."""
        header = ("frame", "image", "time_s", *columns, "fault")
        lines = zip(frames, *columns.values(), strict=True)
        rows = [(f.index, f.name, f.time_s, *values, f.fault) for f, *values in lines]
        write_table(self.folder / name, header, rows)

    def write_frame_arrays(self, name: str, frames: Sequence[Frame], **arrays: Any) -> None:
        """Write an npz file of all frames, with their times if known, and their faults."""
        times, faults = _frame_times(frames), np.array([frame.fault for frame in frames])
        arrays |= {"fault": faults} if times is None else {"time_s": times, "fault": faults}
        write_arrays(self.folder / name, arrays, compressed=True)

    def write_frame_summary(
        self, frames: Sequence[Frame], values: Mapping[str, Any], *lines: str
    ) -> None:
        """Write and log a summary, including the faulty frames after its first line."""
        faulty = [frame for frame in frames if frame.fault]
        listed = [f"  {frame.name}: {frame.fault}" for frame in faulty[:_MAX_LISTED]]
        if len(faulty) > _MAX_LISTED:
            listed.append(f"  and {len(faulty) - _MAX_LISTED} more")
        count = f"{len(faulty)} of {len(frames)} frames are faulty" + (":" if faulty else ".")
        table = [{"frame": f.index, "name": f.name, "fault": f.fault} for f in faulty]
        text = [lines[0], count, *listed, *lines[1:]]
        self.write_summary({"frames": len(frames), "faulty": table, **values}, text)

    def write_summary(self, values: Mapping[str, Any], lines: Sequence[str]) -> None:
        """Write a summary as JSON and as text, and log the text."""
        write_json(self.folder / _SUMMARY, values)
        write_file(self.folder / _TEXT, "\n".join(lines) + "\n")
        log.info("%s", "\n".join(lines))

    def draw(
        self,
        figure: Figure,
        frames: FrameSequence,
        show: Callable[[Frame], None],
        cfg: PictureSettings,
        measured: Sequence[Frame],
        series: Mapping[str, Mapping[str, np.ndarray]],
    ) -> None:
        """Draw pictures of some frames, evenly spaced, a video of all, and a plot over time.

        `show` updates the figure for a frame, `measured` are the frames without images, `series`
        the curves over time by label of the axes and by name.
        """
        total, times = len(measured), _frame_times(measured)
        indices = np.linspace(0, total - 1, min(cfg.pictures, total)).round().astype(int)
        selected = set(indices.tolist())
        suffix = video_suffix() if cfg.video and total > 1 else None
        if cfg.video and total > 1 and suffix is None:
            log.info("no video: this OpenCV can write neither MPEG-4 nor Motion JPEG.")
        with ExitStack() as stack:
            path = self.folder / f"{self.stem}{suffix}"
            period_s = 0.0 if times is None or len(times) < 2 else np.median(np.diff(times))
            rate_hz = float(1.0 / period_s) if period_s > 0 else _DEFAULT_RATE_HZ
            add = stack.enter_context(writing_video(path, rate_hz)) if suffix else None
            report = stack.enter_context(progress("drawing", "frames"))
            for number, frame in enumerate(frames):
                if add is not None or number in selected:
                    show(frame)
                if add is not None:
                    add(render(figure))
                if number in selected:
                    save_figure(figure, self.folder / f"{self.stem}-{frame.index:04d}.png", DPI)
                report(number + 1, total)
        log.info("pictures%s: %s", " and video" if suffix else "", self.folder)
        faulty = [frame.index for frame in measured if frame.fault]
        save_figure(over_time_figure(series, times, faulty), self.folder / OVER_TIME)

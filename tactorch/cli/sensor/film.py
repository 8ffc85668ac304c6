"""Frames drawn one after the other: some as pictures, all as a video; and their summary."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from matplotlib.figure import Figure

from tactorch.cli.outputs import write_json
from tactorch.cli.progress import progress
from tactorch.cli.sensor.options import PictureSettings
from tactorch.cli.sensor.sequence import FrameSequence
from tactorch.cli.settings import log
from tactorch.files import atomic_path
from tactorch.sensor.frames import Frame
from tactorch.viz.figure import save_figure
from tactorch.viz.sensor_frames import DPI, render
from tactorch.viz.video import video_suffix, writing_video

SUMMARY, TEXT, OVER_TIME = "summary.json", "summary.txt", "over_time.png"


@runtime_checkable
class View(Protocol):
    """A figure that is drawn anew for each frame."""

    figure: Figure


def clear(place: Path, stem: str, others: Sequence[str]) -> None:
    """Remove what an earlier run left in the same folder: a stopped one must not seem whole."""
    names = (SUMMARY, TEXT, OVER_TIME, f"{stem}-*.png", f"{stem}.mp4", f"{stem}.avi", *others)
    for name in names:
        for stale in place.glob(name):
            stale.unlink()


def draw(
    place: Path,
    stem: str,
    view: View,
    frames: FrameSequence,
    show: Callable[[Frame], None],
    cfg: PictureSettings,
    known: Sequence[Frame],
    rate_hz: float,
) -> None:
    """Draw frames: pictures of some, evenly picked, and a video of all.

    Args:
        place: Folder of the run.
        stem: What files are called.
        view: The figure.
        frames: The frames.
        show: Puts a frame into the figure.
        cfg: Settings with `pictures` and `video`.
        known: The frames as they were when they were measured.
        rate_hz: Frames a second in the video.
    """
    total = len(known)
    picked = set(np.linspace(0, total - 1, min(cfg.pictures, total)).round().astype(int).tolist())
    suffix = video_suffix() if cfg.video and total > 1 else None
    if cfg.video and total > 1 and suffix is None:
        log.info("no video: this OpenCV can write neither MPEG-4 nor Motion JPEG.")
    with ExitStack() as stack:
        path = place / f"{stem}{suffix}"
        add = stack.enter_context(writing_video(path, rate_hz)) if suffix else None
        tell = stack.enter_context(progress("drawing", "frames"))
        for number, frame in enumerate(frames):
            if add is not None or number in picked:
                show(frame)
            if add is not None:
                add(render(view.figure))
            if number in picked:
                save_figure(view.figure, place / f"{stem}-{frame.index:04d}.png", DPI)
            tell(number + 1, total)
    log.info("pictures%s: %s", " and video" if suffix else "", place)


def write_summary(place: Path, values: Mapping[str, Any], lines: Sequence[str]) -> None:
    """Write a summary as JSON and as text, and tell it."""
    write_json(place / SUMMARY, values)
    text = "\n".join(lines)
    with atomic_path(place / TEXT) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")
    log.info("%s", text)

"""The frames that a command goes over, more than once where it draws them too."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from jaxtyping import Float

from tactorch.cli.sensor.options import SequenceSettings
from tactorch.errors import ConfigError
from tactorch.sensor.description import SensorDescription
from tactorch.sensor.frames import Frame, Image, read_frames
from tactorch.sensor.frames.sources import IMAGE_SUFFIXES, VIDEO_SUFFIXES, open_video, video_length

_RATE_HZ = 10.0  # of a video of frames without times
_LISTED = 20  # faulty frames named in a text


class FrameSequence:
    """Frames of a folder, a video, an image or a camera; those of a camera are kept.

    Args:
        cfg: Settings with `frames` and `max_frames`.
        sensor: What they were taken with.
        reference: The gel without contact.
        once: Whether they are gone over once; then a camera may go on without end.

    Raises:
        ConfigError: A camera, which never ends, without `max_frames`.
        FileError: There is nothing to read.
    """

    def __init__(
        self,
        cfg: SequenceSettings,
        sensor: SensorDescription,
        reference: Image,
        *,
        once: bool = False,
    ) -> None:
        self._once = once
        self.source, self.most = cfg.frames, cfg.max_frames
        self.sensor, self.reference = sensor, reference
        if self.most is not None and self.most < 1:
            raise ConfigError(f"max_frames={self.most} must be at least 1, or null.")
        if isinstance(self.source, int) and self.most is None and not once:
            raise ConfigError(f"frames={self.source} is a camera; give max_frames too.")
        self._kept: list[Frame] | None = None
        self.zero_unix_s: float | None = None  # of a camera, once a frame came
        self._first = self._read()  # what is not there is told at once

    def __iter__(self) -> Iterator[Frame]:
        """Go over the frames from the first."""
        if self._once:
            return self._first
        if not isinstance(self.source, int):
            return self._read()
        return self._camera() if self._kept is None else iter(self._kept)

    @property
    def is_camera(self) -> bool:
        """Whether frames are taken while they are gone over."""
        return isinstance(self.source, int)

    @property
    def total(self) -> int:
        """How many frames there are, as far as is known before they are read."""
        found = 1
        if isinstance(self.source, int):
            found = int(self.most or 1)
        elif isinstance(self.source, Path) and self.source.is_dir():
            found = sum(p.suffix.lower() in IMAGE_SUFFIXES for p in self.source.iterdir())
        elif isinstance(self.source, Path) and self.source.suffix.lower() in VIDEO_SUFFIXES:
            capture = open_video(self.source)
            found = video_length(capture)
            capture.release()
        return found if self.most is None else min(found, self.most)

    def _read(self) -> Iterator[Frame]:
        frames = read_frames(self.source, self.sensor, self.reference)
        return self._passed(frames)

    def _passed(self, frames: Iterator[Frame]) -> Iterator[Frame]:
        """Frames up to `most`, after which a camera is let go; its clock is noted."""
        for count, frame in enumerate(frames, start=1):
            if self.zero_unix_s is None and None not in (frame.unix_s, frame.time_s):
                self.zero_unix_s = cast(float, frame.unix_s) - cast(float, frame.time_s)
            yield frame
            if count == self.most:
                return

    def _camera(self) -> Iterator[Frame]:
        kept = []
        for frame in self._first:
            kept.append(frame)
            yield frame
        self._kept = kept


def without_image(frame: Frame, fault: str = "") -> Frame:
    """Return what is told of a frame, with a fault that was found later."""
    return replace(
        frame, image=None, fault="; ".join(part for part in (frame.fault, fault) if part)
    )


def times_of(frames: Sequence[Frame]) -> Float[np.ndarray, " f"] | None:
    """Return the times of frames, s; None where some are unknown."""
    times = [frame.time_s for frame in frames if frame.time_s is not None]
    return np.array(times) if len(times) == len(frames) else None


def rate_of(frames: Sequence[Frame]) -> float:
    """Return about how many frames there are in a second."""
    times = times_of(frames)
    if times is None or len(times) < 2:
        return _RATE_HZ
    period = float(np.median(np.diff(times)))
    return 1.0 / period if period > 0 else _RATE_HZ


def faults_of(frames: Sequence[Frame]) -> list[dict[str, Any]]:
    """Return the frames with faults, as a summary lists them."""
    return [{"frame": f.index, "name": f.name, "fault": f.fault} for f in frames if f.fault]


def faults_told(frames: Sequence[Frame]) -> list[str]:
    """Return lines on faulty frames."""
    faulty = [frame for frame in frames if frame.fault]
    lines = [f"{len(faulty)} of {len(frames)} frames are faulty" + (":" if faulty else ".")]
    lines += [f"  {frame.name}: {frame.fault}" for frame in faulty[:_LISTED]]
    if len(faulty) > _LISTED:
        lines.append(f"  and {len(faulty) - _LISTED} more")
    return lines


def caption_of(frame: Frame, total: int, told: str) -> str:
    """Return two lines over a picture of a frame."""
    time = "" if frame.time_s is None else f", {frame.time_s:.2f} s"
    fault = frame.fault if len(frame.fault) < 70 else frame.fault[:67] + "..."
    return f"frame {frame.index} of {total}{time}: {told}\n{fault or ' '}"

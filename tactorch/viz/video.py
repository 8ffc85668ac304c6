"""Videos, written atomically."""

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from tactorch.errors import FileError
from tactorch.files import atomic_path

# VP9 plays in browsers; nearly every build of OpenCV has the others.
_CODECS = ((".mp4", "vp09"), (".mp4", "mp4v"), (".avi", "MJPG"))


@contextmanager
def writing_video(
    path: str | Path, rate_hz: float
) -> Iterator[Callable[[UInt8[np.ndarray, "h w 3"]], None]]:
    """Provide a function that appends an RGB image to a video; the file appears at the end."""
    import cv2

    writer: Any = None

    def add(image: UInt8[np.ndarray, "h w 3"]) -> None:
        nonlocal writer
        if writer is None:
            writer = _open_writer(temporary, rate_hz, image)
        writer.write(cv2.cvtColor(image, cv2.COLOR_RGB2BGR))

    with atomic_path(path) as temporary:
        try:
            yield add
        finally:
            if writer is not None:
                writer.release()
        if writer is None:
            raise FileError(f"video '{path}' has no image.")


def _open_writer(path: Path, rate_hz: float, image: UInt8[np.ndarray, "h w 3"]) -> Any:
    import cv2

    size = (image.shape[1], image.shape[0])
    for codec in (codec for suffix, codec in _CODECS if suffix == path.suffix):
        writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), rate_hz, size)
        if writer.isOpened():
            return writer
        writer.release()
    raise FileError(f"this OpenCV has no codec for {path.suffix} videos.")


def video_suffix() -> str | None:
    """Return the suffix of an available video codec, or None."""
    blank = np.zeros((64, 64, 3), np.uint8)
    with tempfile.TemporaryDirectory() as folder:
        for suffix in dict.fromkeys(suffix for suffix, _ in _CODECS):
            try:
                _open_writer(Path(folder) / f"x{suffix}", 10.0, blank).release()
            except FileError:
                continue
            return suffix
    return None

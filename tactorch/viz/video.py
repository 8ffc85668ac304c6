"""Videos, whole or not at all."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from tactorch.errors import FileError
from tactorch.files import atomic_path

# VP9 plays in browsers; the others are in nearly every build of OpenCV.
_CODECS = ((".mp4", "vp09"), (".mp4", "mp4v"), (".avi", "MJPG"))


@contextmanager
def writing_video(
    path: str | Path, rate_hz: float
) -> Iterator[Callable[[UInt8[np.ndarray, "h w 3"]], None]]:
    """Give a function that adds an RGB image to a video; the file appears when all are added.

    Args:
        path: Of the video; its suffix must be that of a codec that is there, see `video_suffix`.
        rate_hz: Images a second.

    Raises:
        FileError: No codec for the suffix is there, or the file cannot be written.
    """
    import cv2

    writer: Any = None

    def add(image: UInt8[np.ndarray, "h w 3"]) -> None:
        nonlocal writer
        if writer is None:
            writer = _opened(temporary, rate_hz, image)
        writer.write(cv2.cvtColor(image, cv2.COLOR_RGB2BGR))

    with atomic_path(path) as temporary:
        try:
            yield add
        finally:
            if writer is not None:
                writer.release()
        if writer is None:
            raise FileError(f"video '{path}' has no image.")


def _opened(path: Path, rate_hz: float, image: UInt8[np.ndarray, "h w 3"]) -> Any:
    import cv2

    size = (image.shape[1], image.shape[0])
    for suffix, codec in _CODECS:
        if suffix != path.suffix:
            continue
        writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), rate_hz, size)
        if writer.isOpened():
            return writer
        writer.release()
    raise FileError(f"this OpenCV has no codec for {path.suffix} videos.")


def video_suffix() -> str | None:
    """Return the suffix of videos that can be written here; None where none can."""
    import tempfile

    nothing = np.zeros((64, 64, 3), np.uint8)
    with tempfile.TemporaryDirectory() as folder:
        for suffix in dict.fromkeys(suffix for suffix, _ in _CODECS):
            try:
                _opened(Path(folder) / f"x{suffix}", 10.0, nothing).release()
            except FileError:
                continue
            return suffix
    return None

"""Sources of frames: folders of images, video files, cameras and iterables of arrays.

Images are RGB with 8 bits per channel, rows from the top. An unreadable frame is yielded without an
image and with its fault; reading continues with the next.
"""

import io
import re
import time
import warnings
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from queue import Full, Queue
from threading import Event, Thread
from typing import Any

import numpy as np
from jaxtyping import UInt8

from tactorch.errors import FileError
from tactorch.files import require_file, require_folder

#: RGB image with 8 bits per channel.
Image = UInt8[np.ndarray, "_ _ 3"]
#: Path of a folder, an image or a video; number of a camera; or images.
Source = str | Path | int | Iterable[np.ndarray]
IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
VIDEO_SUFFIXES = (".avi", ".mp4", ".mov", ".mkv", ".webm", ".mpg", ".mpeg")

_FORMATS = ("PNG", "JPEG", "BMP", "TIFF")  # as Pillow names them
_MAX_PIXELS = 100_000_000
_MAX_FRAME_RATE_HZ = 100_000.0
_MAX_MISSING_FRAMES = 10_000  # reported at the end of a truncated video
_MAX_QUEUED_FRAMES = 600  # of a camera; later frames are dropped
_CAMERA_TIMEOUT_S = 3.0
_CAMERA_RETRY_S = 0.05
_QUEUE_POLL_S = 0.2


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame of a sensor.

    Attributes:
        index: Position in the sequence, from 0.
        name: File name, or position in the source; for messages.
        image: RGB image; None if unreadable.
        time_s: Time since the first frame; None if unknown.
        fault: Description of the fault, or "".
        usable: Whether the frame can be measured. A frame that is saturated, or that follows
            dropped frames, has a fault but is usable.
        unix_s: Time of capture by a camera, seconds since 1970; None if unknown.
    """

    index: int
    name: str
    image: Image | None
    time_s: float | None = None
    fault: str = ""
    usable: bool = True
    unix_s: float | None = None


def open_source(source: Source) -> Iterator[Frame]:
    """Yield the raw frames of a source in order.

    Args:
        source: Source of the frames. Files of a folder are sorted by name, with numbers in the
            names compared as numbers.

    Returns:
        Iterator over the frames.

    Raises:
        FileError: The source does not exist or has no frames.
    """
    if isinstance(source, int):
        return _open_camera(source)
    if not isinstance(source, str | Path):
        return _array_frames(source)
    path = Path(source)
    if path.suffix.lower() in VIDEO_SUFFIXES:
        return _video_frames(open_video(path), path)
    if path.suffix.lower() in IMAGE_SUFFIXES:
        return iter([Frame(0, path.name, read_image(path))])
    if path.is_file():
        raise FileError(
            f"'{path}' is no source of frames; give a folder, an image"
            f" ({', '.join(IMAGE_SUFFIXES)}) or a video ({', '.join(VIDEO_SUFFIXES)})."
        )
    return _folder_frames(path)


def read_image(path: str | Path) -> Image:
    """Read an image file as RGB.

    Returns:
        The image.

    Raises:
        FileError: The file is missing, damaged, not an image, or has too many pixels.
    """
    import cv2

    require_file(path, "image")
    # cv2.imread prints messages and cannot open every path.
    content = np.fromfile(path, np.uint8)
    _check_image_header(content.tobytes(), path)
    try:
        image = cv2.imdecode(content, cv2.IMREAD_COLOR)
    except cv2.error:
        image = None
    if image is None:
        raise _unreadable(path)
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def _check_image_header(content: bytes, path: str | Path) -> None:
    """Refuse an image that is too large or damaged before memory is allocated for its pixels."""
    from PIL import Image as PillowImage

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of Pillow's own, larger limit
            with PillowImage.open(io.BytesIO(content), formats=_FORMATS) as header:
                width, height = header.size
                if width * height <= _MAX_PIXELS and header.format == "TIFF":
                    header.load()  # OpenCV ignores errors in TIFF data
    except PillowImage.DecompressionBombError as error:
        raise FileError(f"image '{path}' is too large: {error}; give a smaller image.") from error
    except Exception as error:  # errors of damaged files have no common base class
        raise _unreadable(path) from error
    if width * height > _MAX_PIXELS:
        raise FileError(
            f"image '{path}' is too large: {width} x {height} px exceed the limit of"
            f" {_MAX_PIXELS:.0e} pixels; give a smaller image."
        )


def _unreadable(path: str | Path) -> FileError:
    return FileError(
        f"image '{path}' cannot be read: it is damaged or no image; take or copy it again."
    )


def _folder_frames(path: Path) -> Iterator[Frame]:
    folder = require_folder(path, "folder of frames")
    files = sorted(
        (p for p in folder.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES and p.name[0] != "."),
        key=lambda p: [int(w) if w.isdigit() else w for w in re.split(r"(\d+)", p.name)],
    )
    if not files:
        raise FileError(f"folder of frames '{path}' has no image ({', '.join(IMAGE_SUFFIXES)}).")
    return (_image_frame(index, file) for index, file in enumerate(files))


def _image_frame(index: int, path: Path) -> Frame:
    try:
        return Frame(index, path.name, read_image(path))
    except FileError as error:
        return Frame(index, path.name, None, fault=str(error), usable=False)


def open_video(path: Path) -> Any:
    """Open a video file.

    Returns:
        The `cv2.VideoCapture`.

    Raises:
        FileError: The file is missing, damaged, of an unknown codec, or has too many pixels.
    """
    import cv2

    require_file(path, "video")
    capture = cv2.VideoCapture(str(path))
    if not capture.isOpened():
        raise FileError(f"video '{path}' cannot be opened: it is damaged, or of an unknown codec.")
    width, height = (
        capture.get(key) for key in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
    )
    if not width * height <= _MAX_PIXELS:
        capture.release()
        raise FileError(
            f"video '{path}' is too large: {width:.0f} x {height:.0f} px exceed the limit of"
            f" {_MAX_PIXELS:.0e} pixels; give a smaller video."
        )
    return capture


def video_length(capture: Any) -> int:
    """Return the number of frames that the header of a video declares; 0 if unknown."""
    import cv2

    count = capture.get(cv2.CAP_PROP_FRAME_COUNT)
    return int(count) if 0 < count < 1e9 else 0


def _video_frames(capture: Any, path: Path) -> Iterator[Frame]:
    import cv2

    rate, expected = capture.get(cv2.CAP_PROP_FPS), video_length(capture)
    known_rate = 0 < rate <= _MAX_FRAME_RATE_HZ
    count = 0
    try:
        while True:
            success, image = capture.read()
            if not success:
                break
            rgb = cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
            yield Frame(
                count, f"{path.name} frame {count}", rgb, count / rate if known_rate else None
            )
            count += 1
    except cv2.error as error:
        reason = " ".join(str(error).split())
        raise FileError(f"video '{path}' cannot be decoded: {reason}.") from error
    finally:
        capture.release()
    if not count:
        raise FileError(f"video '{path}' has no frame that can be decoded.")
    for index in range(count, min(expected, count + _MAX_MISSING_FRAMES)):
        fault = f"the video is cut short: {count} of {expected} frames can be decoded"
        yield Frame(index, f"{path.name} frame {index}", None, fault=fault, usable=False)


def _array_frames(images: Iterable[np.ndarray]) -> Iterator[Frame]:
    index = -1
    for index, image in enumerate(images):
        array, name = np.asarray(image), f"frame {index}"
        if array.dtype == np.uint8 and array.ndim == 3 and array.shape[2] == 3:
            yield Frame(index, name, array)
        else:
            fault = (
                f"an image must be (h, w, 3) of uint8, not {array.shape} of {array.dtype}; convert"
                " it to RGB of 8 bits"
            )
            yield Frame(index, name, None, fault=fault, usable=False)
    if index < 0:
        raise FileError("no image was given as a frame; is the source empty?")


def _open_camera(number: int) -> Iterator[Frame]:
    import cv2

    if number < 0:  # OpenCV interprets negative numbers as any camera, and may crash
        raise FileError(f"camera {number} does not exist; cameras are numbered from 0.")
    capture = cv2.VideoCapture(number)
    if not capture.isOpened():
        raise FileError(
            f"camera {number} cannot be opened: it is not there, or another program has it."
        )
    return _camera_frames(capture, number)


def _camera_frames(capture: Any, number: int) -> Iterator[Frame]:
    """Yield frames captured by a thread, so that slow processing delays no capture."""
    queue: Queue[Frame | None] = Queue(_MAX_QUEUED_FRAMES)
    stop = Event()
    thread = Thread(target=_capture, args=(capture, number, queue, stop), daemon=True)
    thread.start()
    try:
        while (frame := queue.get()) is not None:
            yield frame
    finally:
        stop.set()
        thread.join()
        capture.release()
    raise FileError(f"camera {number} gave no image for {_CAMERA_TIMEOUT_S:g} s; is it plugged in?")


def _capture(capture: Any, number: int, queue: Queue[Frame | None], stop: Event) -> None:
    """Queue frames until `stop` is set or the camera times out, then queue None."""
    try:
        for frame in _captured_frames(capture, number, stop):
            with suppress(Full):
                queue.put_nowait(frame)
    finally:  # after an error too: the consumer must not wait forever
        while not stop.is_set():
            with suppress(Full):
                queue.put(None, timeout=_QUEUE_POLL_S)
                break


def _captured_frames(capture: Any, number: int, stop: Event) -> Iterator[Frame]:
    import cv2

    # The monotonic clock is independent of adjustments of the system time.
    start, start_unix, index, last_image_s = time.monotonic(), time.time(), 0, 0.0
    while not stop.is_set():
        success, image = capture.read()
        time_s = time.monotonic() - start
        name, unix_s = f"camera {number} frame {index}", start_unix + time_s
        if success:
            rgb = cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
            yield Frame(index, name, rgb, time_s, unix_s=unix_s)
            last_image_s = time_s
        elif time_s - last_image_s >= _CAMERA_TIMEOUT_S:
            return
        else:
            yield Frame(index, name, None, time_s, "the camera gave no image", False, unix_s)
            time.sleep(_CAMERA_RETRY_S)
        index += 1

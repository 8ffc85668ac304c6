"""Frames of image files, videos and cameras, rectified and checked for faults.

Images are RGB with 8 bits per channel, rows from the top. An unreadable frame is yielded without an
image and with its fault; reading continues with the next.
"""

import io
import os
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from queue import Full, Queue
from threading import Event, Thread
from typing import Any

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8
from PIL import Image as PillowImage
from PIL import UnidentifiedImageError

from tactorch.budget import MAX_PIXELS, check_memory, read_content
from tactorch.config import Options, option
from tactorch.errors import ConfigError, FileError
from tactorch.files import natural_key, require_file, require_folder
from tactorch.sensor.description import SensorDescription
from tactorch.sensor.table import read_rows

#: RGB image with 8 bits per channel.
Image = UInt8[np.ndarray, "_ _ 3"]
#: Path of a folder, an image or a video; number of a camera; or images.
Source = str | Path | int | Iterable[np.ndarray]
IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
VIDEO_SUFFIXES = (".avi", ".mp4", ".mov", ".mkv", ".webm", ".mpg", ".mpeg")

_FORMATS = ("PNG", "JPEG", "BMP", "TIFF")  # as Pillow names them
# The orientation is that of the camera, which does not turn relative to the gel.
_DECODING = cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
_TWELVE_BITS = 4095  # of 16, which are fewer than 16 of 255 gray values: no image of a lit gel
_SAVE_AS_PNG = "save it as PNG with 8 bits per channel"
# First bytes of files that are not read, whatever their names.
_REFUSED = {b"GIF8": "GIF", b"RIFF": "WebP", b"II*\0": "TIFF of floats", b"MM\0*": "TIFF of floats"}
_MAX_SCANS = 100  # of a progressive JPEG, each of which takes the time of a picture
_MAX_FRAME_RATE_HZ = 100_000.0
_MAX_MISSING_FRAMES = 10_000  # reported at the end of a truncated video
_MAX_QUEUED_FRAMES = 600  # of a camera; later frames are dropped
_MAX_QUEUED_BYTES = 400_000_000  # of these frames
_CAMERA_TIMEOUT_S = 3.0
_CAMERA_RETRY_S = 0.05
_QUEUE_POLL_S = 0.2
_DROPPED_PERIODS = 1.5  # frame periods between two frames, above which frames were dropped
_MIN_BRIGHTNESS = 8.0  # of a reference, gray values
_SATURATED = "saturated"
_SATURATED_VALUE = 254
# Width of the edge of a contact, and of the rows compared beside it, in fractions of the height.
_EDGE, _BESIDE = 40, 20
_MIN_JUMP = 4.0  # between rows or images, gray values; smaller ones are noise
_THIN = 3  # of so many rows and columns one is compared
_MATCH = 0.3  # of the difference from the reference, which is left where red and blue are swapped


@dataclass(frozen=True)
class FaultLimits(Options):
    """Limits of the detection of faulty frames, relative to the reference image."""

    dark: float = option(
        0.4, "Fraction of the reference's mean brightness below which a frame is dark", ge=0, le=1
    )
    saturated: float = option(
        0.05, "Fraction of saturated pixels in excess of the reference's", ge=0, le=1
    )
    torn: float = option(
        8.0, "Jump between two rows over the median jump, above which a frame is torn", gt=0
    )


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

    def with_faults(self, *faults: str) -> "Frame":
        """Return the frame with further faults; empty ones are none."""
        return replace(self, fault="; ".join(filter(None, (self.fault, *faults))))


def read_frames(
    source: Source,
    sensor: SensorDescription,
    reference: Image,
    *,
    limits: FaultLimits | None = None,
) -> Iterator[Frame]:
    """Yield the rectified frames of a source, with their faults.

    A frame that is unreadable or of another size has no image. A frame that is dark, saturated,
    torn or frozen, or that follows dropped frames, keeps its image. The `reference` is the image of
    the gel without contact, see `read_reference`.
    """
    if reference.shape[:2] != sensor.shape:
        raise ConfigError(
            f"the reference is {reference.shape[1]} x {reference.shape[0]} px, but rectified images"
            f" of the sensor '{sensor.name}' are {sensor.shape[1]} x {sensor.shape[0]}; read it"
            " with read_reference."
        )
    raw_frames = open_source(source)  # not in the generator: a missing source is an error at once
    return _rectified_frames(raw_frames, sensor, reference, limits or FaultLimits())


def _rectified_frames(
    raw_frames: Iterator[Frame], sensor: SensorDescription, reference: Image, limits: FaultLimits
) -> Iterator[Frame]:
    rectify = _rectifier(sensor)
    previous, previous_s = None, None
    for raw in raw_frames:
        image, fault = None, raw.fault
        if raw.image is not None:
            try:
                image = rectify(raw.image, raw.name)
                fault = detect_fault(image, reference, previous, limits)
            except FileError as error:
                fault = str(error)
        # A bright contact saturates some pixels of frames that can be measured.
        usable = image is not None and (not fault or fault.startswith(_SATURATED))
        fault = fault or _dropped_frames(raw.time_s, previous_s, sensor.frame_rate_hz)
        previous = image if image is not None else previous
        previous_s = time_s = raw.time_s
        if time_s is None and sensor.frame_rate_hz is not None:
            time_s = raw.index / sensor.frame_rate_hz
        yield replace(raw, image=image, time_s=time_s, fault=fault, usable=usable)


def read_reference(source: Source, sensor: SensorDescription, frames: int = 1) -> Image:
    """Return the image of the gel without contact: the mean of the first frames of a source.

    Args:
        source: An image; or a folder, video, camera or images that start without contact.
        sensor: Sensor that took the frames.
        frames: Number of readable frames to average.

    Raises:
        FileError: There are too few readable frames, they have the wrong size, or are dark.
        ConfigError: `frames` is less than 1.
    """
    if frames < 1:
        raise ConfigError(f"frames={frames} must be at least 1, the number of frames to average.")
    rectify = _rectifier(sensor)
    readable = ((raw.image, raw.name) for raw in open_source(source) if raw.image is not None)
    total, count = np.zeros((*sensor.shape, 3)), 0
    for image, name in islice(readable, frames):
        total, count = total + rectify(image, name), count + 1
    origin = f"'{source}'" if isinstance(source, str | int | Path) else "the given images"
    if count < frames:
        raise FileError(
            f"reference: {count} of {frames} frames can be read from {origin}; declare images"
            " of the gel without contact."
        )
    mean = total / count
    if mean.mean() < _MIN_BRIGHTNESS:
        raise FileError(
            f"reference: the image from {origin} is dark, {mean.mean():.1f} of 255 on average; are"
            " the sensor's lights on?"
        )
    return mean.round().astype(np.uint8)


def detect_fault(
    image: Image, reference: Image, previous: Image | None, limits: FaultLimits | None = None
) -> str:
    """Return a description of the fault of a rectified frame, or ""."""
    limits = limits or FaultLimits()
    brightness = float(image.mean()) / max(float(reference.mean()), 1e-9)
    if brightness < limits.dark:
        return f"dark: {brightness:.0%} of the reference's brightness"
    saturated, usual = ((i >= _SATURATED_VALUE).any(axis=2).mean() for i in (image, reference))
    if saturated - usual > limits.saturated:
        return f"{_SATURATED}: {saturated - usual:.0%} of the pixels more than in the reference"
    if previous is not None and np.array_equal(image, previous):
        return "frozen: the same as the frame before it"
    if changed := _altered(image, reference):
        return changed
    change = image.astype(np.float32).mean(axis=2) - reference.astype(np.float32).mean(axis=2)
    row = _torn_row(change, limits.torn)
    return "" if row is None else f"torn at row {row}"


def _altered(image: Image, reference: Image) -> str:
    """Return how a program altered the colors of a frame unlike the reference, or ""."""
    thin, light = (i[::_THIN, ::_THIN].astype(np.float32) for i in (image, reference))
    if not np.ptp(thin, axis=2).any() and np.median(np.ptp(light, axis=2)) > _MIN_JUMP:
        return "no colors: all channels are equal, unlike in the reference; record in color"

    def off(values: np.ndarray) -> float:
        return float(np.median(np.abs(values - light).mean(axis=2)))

    usual = off(thin)
    if usual > _MIN_JUMP and off(thin[..., ::-1]) < _MATCH * usual:
        return "red and blue are swapped, compared with the reference; record both alike"
    return ""


def _torn_row(change: Float[np.ndarray, "h w"], limit: float) -> int | None:
    """Return the row at which another frame begins, if the change shows one.

    The change varies smoothly from row to row, and a tear makes it jump over much of the width. At
    the straight edge of a contact it jumps too, but back again within a few rows.
    """
    height = len(change)
    jump = np.median(np.abs(np.diff(change, axis=0)), axis=1)
    row = int(np.argmax(jump)) + 1
    size, typical = jump[row - 1], max(float(np.median(jump)), _MIN_JUMP / limit)
    if size <= limit * typical:
        return None
    gap, reach = max(3, height // _EDGE), max(3, height // _BESIDE)
    above = change[max(row - gap - reach, 0) : row - gap] if row > gap else change[:1]
    below = change[row + gap : row + gap + reach] if row + gap < height else change[-1:]
    # Medians, as markers that move change some rows much.
    step = np.median(np.abs(np.median(below, axis=0) - np.median(above, axis=0)))
    return row if step > 0.5 * size else None


def _dropped_frames(time_s: float | None, previous_s: float | None, rate_hz: float | None) -> str:
    if time_s is None or previous_s is None or rate_hz is None:
        return ""
    periods = (time_s - previous_s) * rate_hz
    if periods <= _DROPPED_PERIODS:
        return ""
    return f"{round(periods) - 1} frames were dropped before it ({time_s - previous_s:.3f} s)"


def _rectifier(sensor: SensorDescription) -> Callable[[Image, str], Image]:
    """Return a function that undistorts, warps and crops an image of a given name.

    The function raises `FileError` for images of another size than the sensor's.
    """
    transform = _rectification(sensor)
    raw_size, rectified_size = sensor.raw_size_px or sensor.image_size_px, sensor.image_size_px

    def rectify(image: Image, name: str) -> Image:
        size = (image.shape[1], image.shape[0])
        if size == rectified_size and (size != raw_size or transform is None):
            return image  # rectified already
        if size != raw_size:
            expected = " x ".join(map(str, raw_size))
            if raw_size != rectified_size:
                expected += f", or rectified {rectified_size[0]} x {rectified_size[1]}"
            raise FileError(
                f"{name} is {size[0]} x {size[1]} px, but the sensor '{sensor.name}' gives"
                f" {expected}; check image_size_px and raw_size_px."
            )
        return np.ascontiguousarray(image if transform is None else transform(image))

    return rectify


def _rectification(sensor: SensorDescription) -> Callable[[Image], Image] | None:
    if sensor.intrinsics_px is not None or sensor.warp_corners_px is not None:
        from tactorch.sensor.camera.lens import Lens  # imports kornia

        with torch.no_grad():
            maps = Lens(sensor).maps().numpy()
        x, y = maps.astype(np.float32).transpose(2, 0, 1)
        # OpenCV samples single images of 8 bits on the CPU faster than torch. Cubic, as the blur of
        # linear interpolation depends on the position within a pixel: errors of markers of 0.012 px
        # fall to 0.008 px.
        return lambda image: cv2.remap(image, x, y, cv2.INTER_CUBIC)
    if sensor.crop_px is not None:
        left, top, width, height = sensor.crop_px
        region = np.s_[top : top + height, left : left + width]
        return lambda image: image[region]
    return None


def open_source(source: Source) -> Iterator[Frame]:
    """Yield the raw frames of a source in order.

    Files of a folder are sorted by name, with numbers in the names compared as numbers. Their times
    are those of the table `times.csv` in the folder, if there is one.
    """
    if isinstance(source, int):
        return _open_camera(source)
    if not isinstance(source, str | Path):
        return _array_frames(source)
    path = Path(source)
    if path.suffix.lower() in VIDEO_SUFFIXES:
        return _video_frames(_open_video(path), path)
    if path.suffix.lower() in IMAGE_SUFFIXES:
        return iter([Frame(0, path.name, read_image(path))])
    if path.is_file():
        raise FileError(
            f"'{path}' is no source of frames; give a folder, an image"
            f" ({', '.join(IMAGE_SUFFIXES)}) or a video ({', '.join(VIDEO_SUFFIXES)})."
        )
    return _folder_frames(path)


def read_image(path: str | Path) -> Image:
    """Read an image file as RGB, with its rows as stored: orientation tags are ignored."""
    # cv2.imread prints messages and cannot open every path.
    content = read_content(require_file(path, "image"))
    try:
        if content.count(b"\xff\xda") > _MAX_SCANS and content.startswith(b"\xff\xd8"):
            raise PillowImage.DecompressionBombError(f"it has more than {_MAX_SCANS} scans")
        # A large or damaged image is refused before memory is allocated for its pixels.
        with (
            warnings.catch_warnings(action="ignore"),  # of Pillow's own, larger limit
            PillowImage.open(io.BytesIO(content), formats=_FORMATS) as header,
        ):
            width, height = header.size
            if width * height > MAX_PIXELS:
                raise PillowImage.DecompressionBombError(
                    f"{width} x {height} px exceed the limit of {MAX_PIXELS:.0e} pixels"
                )
            # Decoded as BGR, converted to RGB, and before that decoded by Pillow (TIFF).
            check_memory(f"image '{path}'", f"{width} x {height} px", 16.0 * width * height)
            if header.format == "TIFF":
                header.load()  # OpenCV ignores errors in TIFF data
            if header.format == "PNG":
                header.verify()  # libpng would print its errors
        image: Any = cv2.imdecode(np.frombuffer(content, np.uint8), _DECODING)
        if image is None or image.dtype not in (np.uint8, np.uint16):
            raise UnidentifiedImageError
        return cv2.cvtColor(_eight_bits(image, path), cv2.COLOR_BGR2RGB)
    except FileError:
        raise
    except PillowImage.DecompressionBombError as error:
        raise FileError(f"image '{path}' is too large: {error}; give a smaller image.") from error
    except Exception as error:  # errors of damaged files have no common base class
        cause, kind = "it is damaged or no image; take or copy it again", _REFUSED.get(content[:4])
        if kind and isinstance(error, UnidentifiedImageError):
            cause = f"it is a {kind}, or damaged; {_SAVE_AS_PNG}"
        raise FileError(f"image '{path}' cannot be read: {cause}.") from error


def _eight_bits(image: np.ndarray, path: str | Path) -> np.ndarray:
    if image.dtype == np.uint16:
        if 0 < (largest := int(image.max())) <= _TWELVE_BITS:
            raise FileError(
                f"image '{path}' has 16 bits per channel, but no value above {largest}: values of"
                f" {largest.bit_length()} bits; scale them to 16 bits, or {_SAVE_AS_PNG}."
            )
        return (image >> 8).astype(np.uint8)
    return image


def _folder_frames(path: Path) -> Iterator[Frame]:
    folder = require_folder(path, "folder of frames")
    files = sorted(
        (p for p in folder.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES and p.name[0] != "."),
        key=natural_key,
    )
    if not files:
        raise FileError(f"folder of frames '{path}' has no image ({', '.join(IMAGE_SUFFIXES)}).")
    times = _read_times(folder / "times.csv", files)
    return (_image_frame(index, file, times.get(file.name)) for index, file in enumerate(files))


def _read_times(path: Path, files: Sequence[Path]) -> dict[str, float]:
    """Return times since the first frame (s) by file name; none where there is no table."""
    if not path.exists():
        return {}
    rows = read_rows(path, "times of frames", ("frame", "time_s"))
    times = {row.text("frame"): row.number("time_s") for row in rows}
    missing = [file.name for file in files if file.name not in times]
    if missing:
        raise FileError(
            f"'{path}' has no time of {missing[0]}, and of {len(missing)} images in all; add them,"
            " or remove the file."
        )
    in_order = np.array([times[file.name] for file in files])
    if not (np.isfinite(in_order).all() and (np.diff(in_order) > 0).all()):
        raise FileError(f"'{path}': time_s must rise with the names of the images; repair it.")
    return times


def _image_frame(index: int, path: Path, time_s: float | None) -> Frame:
    try:
        return Frame(index, path.name, read_image(path), time_s)
    except FileError as error:
        return _faulty_frame(index, path.name, str(error), time_s)


def _faulty_frame(
    index: int, name: str, fault: str, time_s: float | None = None, unix_s: float | None = None
) -> Frame:
    return Frame(index, name, None, time_s, fault, usable=False, unix_s=unix_s)


def video_length(path: Path) -> int:
    """Return the number of frames that the header of a video declares; 0 if unknown."""
    capture = _open_video(path)
    count = _declared_length(capture)
    capture.release()
    return count


def _open_video(path: Path) -> Any:
    """Open a video file as `cv2.VideoCapture`."""
    require_file(path, "video")
    # Also frames within the file that are larger than its header says.
    os.environ.setdefault("OPENCV_FFMPEG_CAPTURE_OPTIONS", f"max_pixels;{MAX_PIXELS}")
    capture = cv2.VideoCapture(str(path))
    if not capture.isOpened():
        raise FileError(f"video '{path}' cannot be opened: it is damaged, or of an unknown codec.")
    width = capture.get(cv2.CAP_PROP_FRAME_WIDTH)
    height = capture.get(cv2.CAP_PROP_FRAME_HEIGHT)
    if not width * height <= MAX_PIXELS:
        capture.release()
        raise FileError(
            f"video '{path}' is too large: {width:.0f} x {height:.0f} px exceed the limit of"
            f" {MAX_PIXELS:.0e} pixels; give a smaller video."
        )
    return capture


def _declared_length(capture: Any) -> int:
    count = capture.get(cv2.CAP_PROP_FRAME_COUNT)
    return int(count) if 0 < count < 1e9 else 0


def _video_frames(capture: Any, path: Path) -> Iterator[Frame]:
    rate, expected = capture.get(cv2.CAP_PROP_FPS), _declared_length(capture)
    known_rate = 0 < rate <= _MAX_FRAME_RATE_HZ
    count, time_s, start_s = 0, None, 0.0
    try:
        while (captured := capture.read())[0]:
            rgb = cv2.cvtColor(captured[1], cv2.COLOR_BGR2RGB)
            stamp_s = capture.get(cv2.CAP_PROP_POS_MSEC) / 1000
            if known_rate and time_s is None:
                time_s, start_s = 0.0, stamp_s
            elif time_s is not None:  # a time stamp that does not rise is none
                rises = time_s < stamp_s - start_s < np.inf
                time_s = stamp_s - start_s if rises else time_s + 1 / rate
            yield Frame(count, f"{path.name} frame {count}", rgb, time_s)
            count += 1
    except cv2.error as error:
        reason = " ".join(str(error).split())
        raise FileError(f"video '{path}' cannot be decoded: {reason}.") from error
    finally:
        capture.release()
    if not count:
        raise FileError(f"video '{path}' has no frame that can be decoded.")
    # Some headers have the duration only, from which OpenCV computes the number of frames.
    missing = expected - max(count, 0 if time_s is None else round(time_s * rate) + 1)
    fault = (
        f"the video is cut short or damaged: {count} of {count + missing} frames can be decoded;"
        " after a damaged frame, times are too early"
    )
    for index in range(count, count + min(missing, _MAX_MISSING_FRAMES)):
        yield _faulty_frame(index, f"{path.name} frame {index}", fault)


def image_fault(image: np.ndarray) -> str:
    """Return why an array is no RGB image with 8 bits per channel, or ""."""
    if image.dtype == np.uint8 and image.ndim == 3 and image.shape[2] == 3:
        return ""
    return (
        f"an image must be (h, w, 3) of uint8, not {image.shape} of {image.dtype}; convert it to"
        " RGB of 8 bits"
    )


def _array_frames(images: Iterable[np.ndarray]) -> Iterator[Frame]:
    index = -1
    for index, image in enumerate(images):
        array, name = np.asarray(image), f"frame {index}"
        fault = image_fault(array)
        yield _faulty_frame(index, name, fault) if fault else Frame(index, name, array)
    if index < 0:
        raise FileError("no image was given as a frame; is the source empty?")


def _open_camera(number: int) -> Iterator[Frame]:
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
    """Queue frames until `stop` is set or the camera times out, then queue None.

    Frames that the queue has no place or memory for are dropped.
    """
    # The monotonic clock is independent of adjustments of the system time.
    start, start_unix, index, last_image_s = time.monotonic(), time.time(), 0, 0.0
    try:
        while not stop.is_set():
            success, image = capture.read()
            time_s = time.monotonic() - start
            name, unix_s = f"camera {number} frame {index}", start_unix + time_s
            if success:
                rgb = cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
                frame = Frame(index, name, rgb, time_s, unix_s=unix_s)
                last_image_s = time_s
            elif time_s - last_image_s >= _CAMERA_TIMEOUT_S:
                return
            else:
                frame = _faulty_frame(index, name, "the camera gave no image", time_s, unix_s)
                time.sleep(_CAMERA_RETRY_S)
            size = 0 if frame.image is None else frame.image.nbytes
            if size * queue.qsize() <= _MAX_QUEUED_BYTES:
                with suppress(Full):
                    queue.put_nowait(frame)
            index += 1
    finally:  # after an error too: the consumer must not wait forever
        while not stop.is_set():
            with suppress(Full):
                queue.put(None, timeout=_QUEUE_POLL_S)
                break

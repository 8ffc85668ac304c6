"""Reading of frames: rectification, faults, and the reference image of the gel without contact."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from jaxtyping import Float

from tactorch.config import Options, option
from tactorch.errors import ConfigError, FileError
from tactorch.mesh.values import Real
from tactorch.sensor.description import SensorDescription
from tactorch.sensor.frames.sources import Frame, Image, Source, open_source

_DROPPED_PERIODS = 1.5  # frame periods between two frames, above which frames were dropped
_MIN_BRIGHTNESS = 8.0  # of a reference, gray values
_SATURATED = "saturated"
_SATURATED_VALUE = 254
_MIN_JUMP = 4.0  # between rows, gray values; smaller ones are noise

_Step = Callable[[Image], Image]


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
        8.0, "Jump between two rows, over the frame's median jump, above which a frame is torn",
        gt=0,
    )  # fmt: skip


def read_frames(
    source: Source,
    sensor: SensorDescription,
    reference: Image,
    *,
    limits: FaultLimits | None = None,
) -> Iterator[Frame]:
    """Yield the rectified frames of a source, with their faults.

    A frame that is unreadable or of another size has no image. A frame that is dark, saturated,
    torn or frozen, or that follows dropped frames, keeps its image.

    Args:
        source: Source of the frames.
        sensor: Sensor that took the frames.
        reference: Image of the gel without contact, see `read_reference`.
        limits: Limits of the fault detection.

    Returns:
        Iterator over the frames.

    Raises:
        FileError: The source does not exist or has no frames.
        ConfigError: The reference has another size than the sensor's images.
    """
    rectify = _rectifier(sensor)
    _check_reference(reference, sensor)
    raw_frames = open_source(source)  # not in the generator: a missing source is an error at once
    return _rectified_frames(raw_frames, rectify, sensor, reference, limits or FaultLimits())


def _rectified_frames(
    raw_frames: Iterator[Frame],
    rectify: Callable[[Image, str], Image],
    sensor: SensorDescription,
    reference: Image,
    limits: FaultLimits,
) -> Iterator[Frame]:
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
            time_s = raw.index / float(sensor.frame_rate_hz)
        yield replace(raw, image=image, time_s=time_s, fault=fault, usable=usable)


def read_reference(source: Source, sensor: SensorDescription, frames: int = 1) -> Image:
    """Return the image of the gel without contact: the mean of the first frames of a source.

    Args:
        source: An image; or a folder, video, camera or images that start without contact.
        sensor: Sensor that took the frames.
        frames: Number of readable frames to average.

    Returns:
        The rectified reference image.

    Raises:
        FileError: There are too few readable frames, they have the wrong size, or are dark.
        ConfigError: `frames` is less than 1.
    """
    if frames < 1:
        raise ConfigError(f"frames={frames} must be at least 1, the number of frames to average.")
    rectify = _rectifier(sensor)
    readable = ((raw.image, raw.name) for raw in open_source(source) if raw.image is not None)
    images = [rectify(image, name) for image, name in islice(readable, frames)]
    is_path = isinstance(source, str | int) or hasattr(source, "is_file")
    origin = f"'{source}'" if is_path else "the given images"
    if len(images) < frames:
        raise FileError(
            f"reference: {len(images)} of {frames} frames can be read from {origin}; declare images"
            " of the gel without contact."
        )
    mean = np.mean(images, axis=0)
    if mean.mean() < _MIN_BRIGHTNESS:
        raise FileError(
            f"reference: the image from {origin} is dark, {mean.mean():.1f} of 255 on average; are"
            " the sensor's lights on?"
        )
    return mean.round().astype(np.uint8)


def detect_fault(
    image: Image, reference: Image, previous: Image | None, limits: FaultLimits | None = None
) -> str:
    """Return a description of the fault of a frame, or "".

    Args:
        image: Rectified frame.
        reference: Image of the gel without contact.
        previous: Previous frame, if any.
        limits: Limits of the fault detection.
    """
    limits = limits or FaultLimits()
    brightness = float(image.mean()) / max(float(reference.mean()), 1e-9)
    if brightness < limits.dark:
        return f"dark: {brightness:.0%} of the reference's brightness"
    excess = _saturated_fraction(image) - _saturated_fraction(reference)
    if excess > limits.saturated:
        return f"{_SATURATED}: {excess:.0%} of the pixels more than in the reference"
    if previous is not None and np.array_equal(image, previous):
        return "frozen: the same as the frame before it"
    row = _torn_row(image, reference, limits.torn)
    return f"torn at row {row}" if row else ""


def _saturated_fraction(image: Image) -> float:
    return float((image >= _SATURATED_VALUE).any(axis=2).mean())


def _torn_row(image: Image, reference: Image, limit: float) -> int:
    """Return the row below a tear, or 0.

    The change against the reference varies smoothly from row to row; a tear makes it jump over much
    of the width at one row.
    """
    change = image.astype(np.float32).mean(axis=2) - reference.astype(np.float32).mean(axis=2)
    jump: Float[np.ndarray, " rows"] = np.median(np.abs(np.diff(change, axis=0)), axis=1)
    row = int(np.argmax(jump))
    typical = max(float(np.median(jump)), _MIN_JUMP / limit)
    return row + 1 if jump[row] > limit * typical else 0


def _check_reference(reference: Image, sensor: SensorDescription) -> None:
    if reference.shape[:2] != sensor.shape:
        height, width = reference.shape[:2]
        raise ConfigError(
            f"the reference is {width} x {height} px, but rectified images of the sensor"
            f" '{sensor.name}' are {sensor.shape[1]} x {sensor.shape[0]}; read it with"
            " read_reference."
        )


def _dropped_frames(time_s: float | None, previous_s: float | None, rate_hz: Real | None) -> str:
    if time_s is None or previous_s is None or rate_hz is None:
        return ""
    periods = (time_s - previous_s) * float(rate_hz)
    if periods <= _DROPPED_PERIODS:
        return ""
    return f"{round(periods) - 1} frames were dropped before it ({time_s - previous_s:.3f} s)"


def _rectifier(sensor: SensorDescription) -> Callable[[Image, str], Image]:
    """Return a function that undistorts, warps and crops an image of a given name.

    The function raises `FileError` for images of another size than the sensor's.
    """
    steps = [*_undistortion(sensor), *_warp(sensor), *_crop(sensor)]
    raw_size, rectified_size = tuple(sensor.raw_size_px or ()), tuple(sensor.image_size_px)

    def rectify(image: Image, name: str) -> Image:
        size = (image.shape[1], image.shape[0])
        if size == rectified_size and (size != raw_size or not steps):
            return image  # rectified already
        if size != raw_size:
            alternative = (
                ""
                if raw_size == rectified_size
                else f", or rectified {rectified_size[0]} x {rectified_size[1]}"
            )
            raise FileError(
                f"{name} is {size[0]} x {size[1]} px, but the sensor '{sensor.name}' gives"
                f" {raw_size[0]} x {raw_size[1]}{alternative}; check image_size_px and raw_size_px."
            )
        for step in steps:
            image = step(image)
        return np.ascontiguousarray(image)

    return rectify


def _undistortion(sensor: SensorDescription) -> list[_Step]:
    if sensor.intrinsics_px is None:
        return []
    import cv2

    fx, fy, cx, cy = map(float, sensor.intrinsics_px)
    matrix = np.array([(fx, 0.0, cx), (0.0, fy, cy), (0.0, 0.0, 1.0)])
    count = len(sensor.distortion)
    coefficients = np.array(sensor.distortion, dtype=float) if count else np.zeros(4)
    assert sensor.raw_size_px is not None
    size = (sensor.raw_size_px[0], sensor.raw_size_px[1])
    x, y = cv2.initUndistortRectifyMap(matrix, coefficients, np.eye(3), matrix, size, cv2.CV_32FC1)
    return [lambda image: cv2.remap(image, x, y, cv2.INTER_LINEAR)]


def _warp(sensor: SensorDescription) -> list[_Step]:
    if sensor.warp_corners_px is None:
        return []
    import cv2

    width, height = sensor.warped_size
    corners = np.array(sensor.warp_corners_px, dtype=np.float32)
    targets = np.array(
        [(0, 0), (width - 1, 0), (width - 1, height - 1), (0, height - 1)], dtype=np.float32
    )
    matrix = cv2.getPerspectiveTransform(corners, targets)
    return [lambda image: cv2.warpPerspective(image, matrix, (width, height))]


def _crop(sensor: SensorDescription) -> list[_Step]:
    if sensor.crop_px is None:
        return []
    left, top, width, height = sensor.crop_px
    return [lambda image: image[top : top + height, left : left + width]]

"""Frames of a sensor, with their times and faults."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np

from tactorch.errors import ConfigError, FileError
from tactorch.mesh.values import Real
from tactorch.sensor.description import SensorDescription
from tactorch.sensor.frames.faults import FaultLimits, fault_of, is_sound
from tactorch.sensor.frames.rectify import rectifier
from tactorch.sensor.frames.source import SourceLike, frames_of
from tactorch.sensor.image import Image

_GAP = 1.5  # frame periods between frames, from which one was dropped

_LEAST_LIGHT = 8.0  # grey values, of a reference


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame of a sensor.

    Attributes:
        index: Its place in the sequence, from 0.
        name: Of its file, or of its place in the source.
        image: RGB, rectified; None where there is none that can be read.
        time_s: Since the first frame; None where unknown.
        fault: What is wrong with it, or "".
        sound: Whether it can be measured on; one that saturates, or before which frames were
            dropped, can.
        unix_s: When a camera gave it, seconds since 1970; None where unknown.
    """

    index: int
    name: str
    image: Image | None
    time_s: float | None
    fault: str = ""
    sound: bool = True
    unix_s: float | None = None


def read_frames(
    source: SourceLike,
    sensor: SensorDescription,
    reference: Image,
    *,
    limits: FaultLimits | None = None,
) -> Iterator[Frame]:
    """Yield the frames of a source, rectified, with what is wrong with each.

    A frame that cannot be read or is of another size comes without an image; one that is dark,
    saturated, torn or frozen, or before which frames were dropped, comes with its fault told.

    Args:
        source: A folder, an image, a video, the number of a camera, or images themselves.
        sensor: What they were taken with.
        reference: Of the gel without contact, see `read_reference`.
        limits: From where on a frame is faulty.

    Raises:
        FileError: There is nothing to read.
        ConfigError: The reference has another size than the sensor's images.
    """
    rectify = rectifier(sensor)
    _check_reference(reference, sensor)
    raws = frames_of(source)  # here, so that a source that is not there is told at once

    def run() -> Iterator[Frame]:
        before, before_s = None, None
        for index, raw in enumerate(raws):
            image, fault = None, raw.fault
            if raw.image is not None:
                try:
                    image = rectify(raw.image, raw.name)
                    fault = fault_of(image, reference, before, limits)
                except FileError as error:
                    fault = str(error)
            sound = image is not None and is_sound(fault)
            fault = fault or _dropped(raw.time_s, before_s, sensor.frame_rate_hz)
            before = image if image is not None else before
            before_s = raw.time_s
            time_s = _time(raw.time_s, index, sensor)
            yield Frame(index, raw.name, image, time_s, fault, sound, raw.unix_s)

    return run()


def read_reference(source: SourceLike, sensor: SensorDescription, frames: int = 1) -> Image:
    """Return the image of a gel without contact, as declared: the mean of a source's first frames.

    Args:
        source: An image, or a folder, video, camera or images that begin without contact.
        sensor: What they were taken with.
        frames: How many to average; those that cannot be read do not count.

    Raises:
        FileError: There are fewer frames that can be read, they have the wrong size, or are dark.
        ConfigError: `frames` is less than 1.
    """
    if frames < 1:
        raise ConfigError(f"frames={frames} must be at least 1: that many make the reference.")
    rectify = rectifier(sensor)
    good = ((raw.image, raw.name) for raw in frames_of(source) if raw.image is not None)
    images = [rectify(image, name) for image, name in islice(good, frames)]
    if len(images) < frames:
        raise FileError(
            f"reference: {len(images)} of {frames} frames can be read from"
            f" {_named(source)}; declare images of the gel without contact."
        )
    mean = np.mean(images, axis=0)
    if mean.mean() < _LEAST_LIGHT:
        raise FileError(
            f"reference: the image from {_named(source)} is dark, {mean.mean():.1f} of 255 on"
            " average; are the sensor's lights on?"
        )
    return mean.round().astype(np.uint8)


def _check_reference(reference: Image, sensor: SensorDescription) -> None:
    if reference.shape[:2] != sensor.shape:
        height, width = reference.shape[:2]
        raise ConfigError(
            f"the reference is {width} x {height} px, but rectified images of the sensor"
            f" '{sensor.name}' are {sensor.shape[1]} x {sensor.shape[0]}; read it with"
            " read_reference."
        )


def _time(time_s: float | None, index: int, sensor: SensorDescription) -> float | None:
    if time_s is not None or sensor.frame_rate_hz is None:
        return time_s
    return index / float(sensor.frame_rate_hz)


def _dropped(time_s: float | None, before_s: float | None, rate_hz: Real | None) -> str:
    if time_s is None or before_s is None or rate_hz is None:
        return ""
    periods = (time_s - before_s) * float(rate_hz)
    if periods <= _GAP:
        return ""
    return f"{round(periods) - 1} frames were dropped before it ({time_s - before_s:.3f} s)"


def _named(source: SourceLike) -> str:
    return f"'{source}'" if isinstance(source, str | int) or hasattr(source, "is_file") else "them"

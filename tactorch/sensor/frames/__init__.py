"""Frames of image files, videos and cameras, rectified and checked for faults."""

from tactorch.sensor.frames.reading import (
    FaultLimits,
    detect_fault,
    read_frames,
    read_reference,
)
from tactorch.sensor.frames.sources import Frame, Image, Source, read_image

__all__ = [
    "FaultLimits",
    "Frame",
    "Image",
    "Source",
    "detect_fault",
    "read_frames",
    "read_image",
    "read_reference",
]

"""Frames from files, videos and cameras, and what is wrong with them."""

from tactorch.sensor.frames.faults import FaultLimits, fault_of
from tactorch.sensor.frames.frames import Frame, read_frames, read_reference
from tactorch.sensor.frames.source import SourceLike, read_image

__all__ = [
    "FaultLimits",
    "Frame",
    "SourceLike",
    "fault_of",
    "read_frames",
    "read_image",
    "read_reference",
]

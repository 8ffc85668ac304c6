"""Recordings from frames and poses of a session, as a batch or while it runs (Section VI-B)."""

from tactorch.sensor.recorder.detector import ContactInterval
from tactorch.sensor.recorder.objects import OBJECTS, BoxObject, MeshObject, VirtualCube
from tactorch.sensor.recorder.press_builder import Fixture, RecordOptions
from tactorch.sensor.recorder.record import record, record_streaming

__all__ = [
    "OBJECTS",
    "BoxObject",
    "ContactInterval",
    "Fixture",
    "MeshObject",
    "RecordOptions",
    "VirtualCube",
    "record",
    "record_streaming",
]

"""From the frames and poses of a whole session to a recording (Section VI-B)."""

from tactorch.sensor.recorder.hold import Hold
from tactorch.sensor.recorder.options import RecordOptions
from tactorch.sensor.recorder.record import Recorded, record
from tactorch.sensor.recorder.region import VirtualCube

__all__ = ["Hold", "RecordOptions", "Recorded", "VirtualCube", "record"]

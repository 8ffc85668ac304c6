"""From the frames and poses of a whole session to a recording (Section VI-B)."""

from tactorch.sensor.recorder.growing import contacts_as_they_end
from tactorch.sensor.recorder.hold import Fixture
from tactorch.sensor.recorder.options import RecordOptions
from tactorch.sensor.recorder.record import Recorded, record
from tactorch.sensor.recorder.region import VirtualCube

__all__ = ["Fixture", "RecordOptions", "Recorded", "VirtualCube", "contacts_as_they_end", "record"]

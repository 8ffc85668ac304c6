"""Markers on the gel: found, followed, and turned into displacements."""

from tactorch.sensor.markers.detect import MarkerLook, detect_markers, marker_mask
from tactorch.sensor.markers.displacement import displacement_mm
from tactorch.sensor.markers.track import MarkerTracker, Tracked, TrackOptions, track

__all__ = [
    "MarkerLook",
    "MarkerTracker",
    "TrackOptions",
    "Tracked",
    "detect_markers",
    "displacement_mm",
    "marker_mask",
    "track",
]

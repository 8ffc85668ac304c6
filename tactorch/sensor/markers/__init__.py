"""Markers on the gel: detection, tracking and displacements."""

from tactorch.sensor.markers.detection import MarkerAppearance, detect_markers, marker_mask
from tactorch.sensor.markers.tracking import (
    MarkerTracker,
    TrackOptions,
    marker_displacements,
    track_markers,
)

__all__ = [
    "MarkerAppearance",
    "MarkerTracker",
    "TrackOptions",
    "detect_markers",
    "marker_displacements",
    "marker_mask",
    "track_markers",
]

"""Recordings: presses on a soft object, what was measured, and the file that holds them."""

from tactorch.recording.append import append_press, compact, read_presses
from tactorch.recording.material import MaterialSpec
from tactorch.recording.press import Press
from tactorch.recording.readings import (
    ForceReading,
    GelReading,
    PressErrors,
    ProbePose,
    SurfaceReading,
)
from tactorch.recording.recording import Recording
from tactorch.recording.refine import prolong_recording, refine_recording

__all__ = [
    "ForceReading",
    "GelReading",
    "MaterialSpec",
    "Press",
    "PressErrors",
    "ProbePose",
    "Recording",
    "SurfaceReading",
    "append_press",
    "compact",
    "prolong_recording",
    "read_presses",
    "refine_recording",
]

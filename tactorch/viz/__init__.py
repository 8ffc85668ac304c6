"""Figures of results: functions that return a matplotlib figure, and `save_figure`.

No text is parsed as mathtext, because names may come from files.
"""

from tactorch.viz.convergence import convergence_figure
from tactorch.viz.figure import save_figure
from tactorch.viz.reconstruction import comparison_figure, reconstruction_figure
from tactorch.viz.slices import slice_figure
from tactorch.viz.uncertainty import (
    calibration_figure,
    credibility_figure,
    depth_figure,
    layer_figure,
    physics_figure,
    sampling_figure,
)

__all__ = [
    "calibration_figure",
    "comparison_figure",
    "convergence_figure",
    "credibility_figure",
    "depth_figure",
    "layer_figure",
    "physics_figure",
    "reconstruction_figure",
    "sampling_figure",
    "save_figure",
    "slice_figure",
]

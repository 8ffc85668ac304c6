"""Figures of results.

Functions named `..._figure` return a matplotlib figure for `save_figure`, functions named
`plot_...` write a file. No text is parsed as mathtext, because names may come from files.
"""

from tactorch.viz.active import sampling_figure
from tactorch.viz.calibration import calibration_figure
from tactorch.viz.convergence import convergence_figure, plot_convergence
from tactorch.viz.credibility import credibility_figure, depth_figure, layer_figure
from tactorch.viz.figure import save_figure
from tactorch.viz.slices import plot_slices, slice_figure

__all__ = [
    "calibration_figure",
    "convergence_figure",
    "credibility_figure",
    "depth_figure",
    "layer_figure",
    "plot_convergence",
    "plot_slices",
    "sampling_figure",
    "save_figure",
    "slice_figure",
]

"""Pictures of results: slices, convergence, credibility by depth, calibration, active sampling."""

from tactorch.viz.active import plot_sampling, sampling_figure
from tactorch.viz.convergence import convergence_figure, plot_convergence
from tactorch.viz.credibility import (
    calibration_figure,
    credibility_figure,
    depth_figure,
    layer_figure,
    plot_calibration,
    plot_depths,
    plot_layers,
)
from tactorch.viz.slices import plot_slices, slice_figure

__all__ = [
    "calibration_figure",
    "convergence_figure",
    "credibility_figure",
    "depth_figure",
    "layer_figure",
    "plot_calibration",
    "plot_convergence",
    "plot_depths",
    "plot_layers",
    "plot_sampling",
    "plot_slices",
    "sampling_figure",
    "slice_figure",
]

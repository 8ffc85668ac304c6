"""Pictures of results: slices through maps, curves of convergence, credibility by depth."""

from tactorch.viz.convergence import convergence_figure, plot_convergence
from tactorch.viz.credibility import credibility_figure, layer_figure, plot_layers
from tactorch.viz.slices import plot_slices, slice_figure

__all__ = [
    "convergence_figure",
    "credibility_figure",
    "layer_figure",
    "plot_convergence",
    "plot_layers",
    "plot_slices",
    "slice_figure",
]

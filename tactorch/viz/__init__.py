"""Pictures of results: slices through maps, curves of convergence."""

from tactorch.viz.convergence import convergence_figure, plot_convergence
from tactorch.viz.slices import plot_slices, slice_figure

__all__ = ["convergence_figure", "plot_convergence", "plot_slices", "slice_figure"]

"""Pictures of the credibility metric: its fall with depth, and slices (Fig. 3)."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from tactorch.errors import ConfigError
from tactorch.mesh import TetMesh
from tactorch.viz._figure import new_figure, save_figure
from tactorch.viz.slices import LABEL, slice_figure

METRIC = "credibility L (mm/MPa)"


def plot_layers(
    curves: Mapping[str, tuple[np.ndarray, np.ndarray]], path: str | Path, *, title: str = ""
) -> Path:
    """Draw `layer_figure` to a file (png, pdf or svg) and return its path."""
    return save_figure(layer_figure(curves, title=title), path)


def layer_figure(curves: Mapping[str, tuple[np.ndarray, np.ndarray]], *, title: str = "") -> Figure:
    """Draw the metric of each layer against where the layer lies.

    Args:
        curves: Per label, what `tactorch.credibility.layer_profile` returned.
        title: Printed above.

    Raises:
        ConfigError: No curve is given.
    """
    if not curves:
        raise ConfigError("layer_figure: no curve given; pass at least one layer profile.")
    figure = new_figure(5.5, 4.0)
    axes = figure.subplots()
    for name, (centres, sums) in curves.items():
        axes.semilogy(centres, sums, marker="o", markersize=4, label=name)
    axes.set_xlabel("layer centre (mm)")
    axes.set_ylabel("integrated metric of the layer")
    axes.grid(True, alpha=0.3)
    axes.legend(frameon=False)
    axes.set_title(title)
    return figure


def credibility_figure(
    mesh: TetMesh, values: Float[np.ndarray, " m"], *, n_slices: int = 5, label: str = METRIC
) -> Figure:
    """Draw slices of a metric across x, y and z; see `tactorch.viz.slice_figure`."""
    figure = slice_figure(mesh, values, n_slices=n_slices, cmap="cividis")
    for axes in figure.axes:
        if axes.get_ylabel() == LABEL:
            axes.set_ylabel(label)
    return figure

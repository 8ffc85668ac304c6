"""Figure of maps of several runs, side by side."""

from collections.abc import Mapping

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure

from tactorch.errors import ConfigError
from tactorch.inverse import Reconstruction
from tactorch.text import one_line
from tactorch.viz.figure import MODULUS_LABEL, new_grid
from tactorch.viz.slicing import colour_scale, slices_at

_INCHES = 2.3
_PIXELS = 90
_MAX_NAME = 90


def comparison_figure(
    runs: Mapping[str, Reconstruction], *, common: bool = True, cmap: str = "viridis"
) -> Figure:
    """Return a figure with three slices of each map, one run in each row.

    Args:
        runs: Results of inversions by name.
        common: Whether all runs have one colour scale, rather than one each.
        cmap: Name of a matplotlib colour map.

    Raises:
        ConfigError: There is no run.
    """
    if not runs:
        raise ConfigError("comparison_figure: no run given; pass at least one.")
    everything = np.concatenate([run.youngs for run in runs.values()])
    figure, grid = new_grid(3 * _INCHES + 1.6, _INCHES * len(runs) + 0.4, len(runs), 3)
    for row, (name, run) in zip(grid, runs.items(), strict=True):
        scaled = everything if common else run.youngs
        norm = colour_scale({"reconstruction": scaled}, "linear", None)
        center = np.mean(run.mesh.bounds, axis=0)
        for axes, piece in zip(row, slices_at(run.mesh, center, _PIXELS), strict=True):
            piece.draw(axes, run.youngs, cmap=cmap, norm=norm)
            piece.label(axes, top=False, fontsize=7)
        row[1].set_title(one_line(name, _MAX_NAME), fontsize=8)
        if not common:
            figure.colorbar(ScalarMappable(norm, cmap), ax=row, label=MODULUS_LABEL, shrink=0.9)
    if common:
        figure.colorbar(ScalarMappable(norm, cmap), ax=grid, label=MODULUS_LABEL, shrink=0.8)
    return figure

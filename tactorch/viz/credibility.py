"""Figures of the credibility metric: slices, and its decrease with depth (Fig. 3 of the paper)."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure, SubFigure

from tactorch.mesh import TetMesh
from tactorch.viz.figure import MODULUS_LABEL, new_figure, require_curves
from tactorch.viz.slices import slice_figure
from tactorch.viz.slicing import slice_body

METRIC = "credibility L (mm/MPa)"
_SLICES = 4  # slices across z in `depth_figure`
Curves = Mapping[str, np.ndarray]


def layer_figure(curves: Mapping[str, tuple[np.ndarray, np.ndarray]], *, title: str = "") -> Figure:
    """Draw the metric of each layer against the position of the layer.

    Args:
        curves: Result of `tactorch.uncertainty.layer_profile` by label.
        title: Title of the figure.

    Returns:
        The figure.

    Raises:
        ConfigError: There is no curve.
    """
    require_curves("layer_figure", curves)
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
    """Draw slices of a metric across x, y and z; see `tactorch.viz.slice_figure`.

    Args:
        mesh: Mesh of the body.
        values: Metric of each element, (m,).
        n_slices: Number of slices across each axis.
        label: Label of the colour bar.

    Returns:
        The figure.
    """
    figure = slice_figure(mesh, values, n_slices=n_slices, cmap="cividis")
    for axes in figure.axes:
        if axes.get_ylabel() == MODULUS_LABEL:
            axes.set_ylabel(label)
    return figure


def depth_figure(
    groups: Mapping[str, Curves],
    mesh: TetMesh,
    values: Float[np.ndarray, " m"],
    *,
    slices_of: str = "",
) -> Figure:
    """Draw layer integrals against depth, one panel per group, and slices of one map (Fig. 3).

    Args:
        groups: Curves by label of each panel: integrals of equal layers, the top one first.
        mesh: Mesh of the body.
        values: Positive metric of each element in the slices, (m,).
        slices_of: Label of the curve that the slices belong to.

    Returns:
        The figure.

    Raises:
        ConfigError: There is no group, or one has no curve.
    """
    require_curves("depth_figure", groups)
    figure = new_figure(3.2 * max(len(groups), 3), 6.6)
    grid = figure.add_gridspec(2, 1, height_ratios=[1.25, 1.0])
    _draw_depths(figure.add_subfigure(grid[0]), groups)
    lower = figure.add_subfigure(grid[1])
    _draw_layers(lower, mesh, values)
    lower.suptitle(f"Slices, {slices_of}" if slices_of else "Slices", fontsize=10)
    return figure


def _draw_depths(part: SubFigure, groups: Mapping[str, Curves]) -> None:
    """Draw one panel of curves per group."""
    panels = part.subplots(1, len(groups), sharey=True, squeeze=False)[0]
    for axes, (title, curves) in zip(panels, groups.items(), strict=True):
        for name, sums in curves.items():
            depths = (np.arange(len(sums)) + 0.5) / len(sums)
            axes.semilogy(depths, sums, marker="o", markersize=3, label=name)
        axes.set_title(title, fontsize=10)
        axes.set_xlabel("depth (fraction of the height)")
        axes.grid(True, which="both", alpha=0.25)
        axes.legend(frameon=False, fontsize=8)
    panels[0].set_ylabel("sum of L over the layer (mm/MPa)")


def _draw_layers(part: SubFigure, mesh: TetMesh, values: np.ndarray) -> None:
    """Draw horizontal slices with one colour scale, the top one first."""
    norm = LogNorm(float(values[values > 0].min()), float(values.max()))
    panels = part.subplots(1, _SLICES)
    for axes, piece in zip(panels, slice_body(mesh, _SLICES, 160)[2][::-1], strict=True):
        image = piece.draw(axes, values, cmap="cividis", norm=norm)
        axes.set_title(f"z = {piece.position_mm:.3g} mm", fontsize=9)
        axes.tick_params(labelsize=8)
        axes.set_xlabel("x (mm)", fontsize=9)
    panels[0].set_ylabel("y (mm)", fontsize=9)
    part.colorbar(image, ax=panels, label="L per volume (mm/MPa/mm³)", aspect=15, pad=0.02)

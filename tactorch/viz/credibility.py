"""Pictures of the credibility metric: its fall with depth, and slices (Fig. 3)."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure, SubFigure

from tactorch.errors import ConfigError
from tactorch.mesh import TetMesh
from tactorch.viz._figure import new_figure, save_figure
from tactorch.viz.sampling import slice_body
from tactorch.viz.slices import LABEL, slice_figure

METRIC = "credibility L (mm/MPa)"
_SLICES = 4  # across z, beside the curves of `depth_figure`
Curves = Mapping[str, np.ndarray]


def plot_layers(
    curves: Mapping[str, tuple[np.ndarray, np.ndarray]], path: str | Path, *, title: str = ""
) -> Path:
    """Draw `layer_figure` to a file (png, pdf or svg) and return its path."""
    return save_figure(layer_figure(curves, title=title), path)


def layer_figure(curves: Mapping[str, tuple[np.ndarray, np.ndarray]], *, title: str = "") -> Figure:
    """Draw the metric of each layer against where the layer lies.

    Args:
        curves: Per label, what `tactorch.uncertainty.layer_profile` returned.
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


def plot_calibration(
    curves: Mapping[str, Float[np.ndarray, " k"]], path: str | Path, *, title: str = ""
) -> Path:
    """Draw `calibration_figure` to a file (png, pdf or svg) and return its path."""
    return save_figure(calibration_figure(curves, title=title), path)


def calibration_figure(curves: Mapping[str, Float[np.ndarray, " k"]], *, title: str = "") -> Figure:
    """Draw the covered share against the stated level: on the diagonal where intervals hold.

    Args:
        curves: Per label, what `tactorch.uncertainty.calibration_curve` returned at its own
            levels.
        title: Printed above.

    Raises:
        ConfigError: No curve is given.
    """
    if not curves:
        raise ConfigError("calibration_figure: no curve given; pass at least one.")
    figure = new_figure(5.0, 4.6)
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], color="0.5", linewidth=1, linestyle="--", label="as stated")
    for name, covered in curves.items():
        levels = np.linspace(0.05, 0.95, len(covered))
        axes.plot(levels, covered, marker="o", markersize=3, label=name)
    axes.vlines(0.9, 0.85, 0.95, color="black", linewidth=3, label="aim at 90 %: 85 to 95 %")
    axes.set_xlim(0, 1)
    axes.set_ylim(0, 1)
    axes.set_aspect("equal")
    axes.set_xlabel("level that the intervals state")
    axes.set_ylabel("share of elements they cover")
    axes.grid(True, alpha=0.3)
    axes.legend(frameon=False, fontsize=8)
    axes.set_title(title)
    return figure


def plot_depths(
    groups: Mapping[str, Curves],
    mesh: TetMesh,
    values: Float[np.ndarray, " m"],
    path: str | Path,
    *,
    slices_of: str = "",
) -> Path:
    """Draw `depth_figure` to a file (png, pdf or svg) and return its path."""
    return save_figure(depth_figure(groups, mesh, values, slices_of=slices_of), path)


def depth_figure(
    groups: Mapping[str, Curves],
    mesh: TetMesh,
    values: Float[np.ndarray, " m"],
    *,
    slices_of: str = "",
) -> Figure:
    """Draw layer integrals against depth, a panel a group, above slices of one map (Fig. 3).

    Args:
        groups: Per panel, per label: integrals of equal layers, the top one first.
        mesh: The body.
        values: Positive metric of each element, for the slices.
        slices_of: Which of the curves the slices belong to.

    Raises:
        ConfigError: No curve is given.
    """
    if not groups or not all(groups.values()):
        raise ConfigError("depth_figure: no curve given; pass at least one group of them.")
    figure = new_figure(3.2 * max(len(groups), 3), 6.6)
    grid = figure.add_gridspec(2, 1, height_ratios=[1.25, 1.0])
    _draw_depths(figure.add_subfigure(grid[0]), groups)
    lower = figure.add_subfigure(grid[1])
    _draw_layers(lower, mesh, values)
    lower.suptitle(f"Slices, {slices_of}" if slices_of else "Slices", fontsize=10)
    return figure


def _draw_depths(part: SubFigure, groups: Mapping[str, Curves]) -> None:
    """Draw a panel of curves a group."""
    panels = part.subplots(1, len(groups), sharey=True, squeeze=False)[0]
    for axes, (title, curves) in zip(panels, groups.items(), strict=True):
        for name, sums in curves.items():
            depths = (np.arange(len(sums)) + 0.5) / len(sums)
            axes.semilogy(depths, sums, marker="o", markersize=3, label=name)
        axes.set_title(title, fontsize=10)
        axes.set_xlabel("depth (share of the height)")
        axes.grid(True, which="both", alpha=0.25)
        axes.legend(frameon=False, fontsize=8)
    panels[0].set_ylabel("sum of L over the layer (mm/MPa)")


def _draw_layers(part: SubFigure, mesh: TetMesh, values: np.ndarray) -> None:
    """Draw horizontal slices, the top one first, with one scale."""
    norm = LogNorm(float(values[values > 0].min()), float(values.max()))
    panels = part.subplots(1, _SLICES)
    for axes, piece in zip(panels, slice_body(mesh, _SLICES, 160)[2][::-1], strict=True):
        image = axes.imshow(
            piece.values(values), extent=piece.extent_mm, origin="lower", cmap="cividis", norm=norm
        )
        axes.set_title(f"z = {piece.position_mm:.3g} mm", fontsize=9)
        axes.tick_params(labelsize=8)
        axes.set_xlabel("x (mm)", fontsize=9)
    panels[0].set_ylabel("y (mm)", fontsize=9)
    part.colorbar(image, ax=panels, label="L per volume (mm/MPa/mm³)", aspect=15, pad=0.02)

"""Figures of uncertainty: credibility, calibration of intervals and active sampling."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure, SubFigure

from tactorch.inverse import PhysicsImage
from tactorch.mesh import Sphere, TetMesh
from tactorch.viz.figure import (
    add_legend,
    draw_depth_curves,
    draw_diagonal,
    new_axes,
    new_figure,
    require_curves,
)
from tactorch.viz.slices import slice_figure
from tactorch.viz.slicing import cut, even_planes

METRIC = "credibility L (mm/MPa)"
_NOISE = 3.0  # standard deviations, to which a scale of noise alone reaches
_SLICES = 4  # slices across z in `depth_figure`
_ANGLES = np.linspace(0.0, 2.0 * np.pi, 73)
Groups = Mapping[str, Mapping[str, np.ndarray]]


def physics_figure(image: PhysicsImage, *, n_slices: int = 5, title: str = "") -> Figure:
    """Return slices of the signal over noise of the presses: red where they show a stiffer place.

    Args:
        image: Result of `tactorch.inverse.physics_image`.
        n_slices: Number of evenly spaced slices across each axis.
        title: Title of the figure.
    """
    signal = image.grid.at_elements(image.signal)
    largest = max(float(np.abs(signal).max()), _NOISE)
    return slice_figure(
        image.grid.mesh, signal, n_slices=n_slices, limits_mpa=(-largest, largest), cmap="RdBu_r",
        label="signal over noise", title=title,
    )  # fmt: skip


def layer_figure(curves: Mapping[str, tuple[np.ndarray, np.ndarray]], *, title: str = "") -> Figure:
    """Return a figure of the credibility of each layer against the position of the layer.

    Args:
        curves: Result of `tactorch.inverse.posterior.layer_profile` by label.
        title: Title of the figure.
    """
    require_curves("layer_figure", curves)
    figure, axes = new_axes(5.5, 4.0)
    for name, (centres, sums) in curves.items():
        axes.semilogy(centres, sums, marker="o", markersize=4, label=name)
    axes.set(xlabel="layer centre (mm)", ylabel="integrated metric of the layer", title=title)
    add_legend(axes, None)
    return figure


def credibility_figure(
    mesh: TetMesh, values: Float[np.ndarray, " m"], *, n_slices: int = 5, label: str = METRIC
) -> Figure:
    """Return a figure of `n_slices` slices of a metric of each element across x, y and z each."""
    return slice_figure(mesh, values, n_slices=n_slices, cmap="cividis", label=label)


def depth_figure(
    groups: Groups, mesh: TetMesh, values: Float[np.ndarray, " m"], *, slices_of: str = ""
) -> Figure:
    """Return a figure of layer integrals against depth, and of slices of one map (Fig. 3).

    Args:
        groups: Curves by label of each panel: integrals of equal layers, the top one first.
        mesh: Mesh of the body.
        values: Positive metric of each element in the slices, (m,).
        slices_of: Label of the curve that the slices belong to.
    """
    require_curves("depth_figure", groups)
    figure = new_figure(3.2 * max(len(groups), 3), 6.6)
    grid = figure.add_gridspec(2, 1, height_ratios=[1.25, 1.0])
    upper, lower = figure.add_subfigure(grid[0]), figure.add_subfigure(grid[1])
    panels = upper.subplots(1, len(groups), sharey=True, squeeze=False)
    draw_depth_curves(panels, groups, "sum of L over the layer (mm/MPa)", "log")
    _draw_layers(lower, mesh, values)
    lower.suptitle(f"Slices, {slices_of}" if slices_of else "Slices", fontsize=10)
    return figure


def _draw_layers(part: SubFigure, mesh: TetMesh, values: np.ndarray) -> None:
    """Draw horizontal slices with one colour scale, the top one first."""
    norm = LogNorm(float(values[values > 0].min()), float(values.max()))
    panels = part.subplots(1, _SLICES)
    slices = cut(mesh, even_planes(mesh, 2, _SLICES)[::-1], 160)
    for axes, piece in zip(panels, slices, strict=True):
        piece.draw(axes, values, cmap="cividis", norm=norm)
        piece.label(axes, left=axes is panels[0])
    part.colorbar(
        panels[-1].images[0], ax=panels, label="L per volume (mm/MPa/mm³)", aspect=15, pad=0.02
    )


def calibration_figure(curves: Mapping[str, Float[np.ndarray, " k"]], *, title: str = "") -> Figure:
    """Return a figure of the coverage of intervals by level; exact ones are on the diagonal.

    Args:
        curves: Results of `tactorch.metrics.coverage.calibration_curve` by label, at its levels.
        title: Title of the figure.
    """
    require_curves("calibration_figure", curves)
    figure, axes = new_axes(5.0, 4.6)
    draw_diagonal(axes)
    for name, covered in curves.items():
        levels = np.linspace(0.05, 0.95, len(covered))
        axes.plot(levels, covered, marker="o", markersize=3, label=name)
    axes.vlines(0.9, 0.85, 0.95, color="black", linewidth=3, label="target at 90 %: 85 to 95 %")
    axes.set(aspect="equal", xlabel="level of the intervals", ylabel="fraction of elements covered")
    axes.set_title(title)
    add_legend(axes)
    return figure


def sampling_figure(
    curves: Mapping[str, Float[np.ndarray, "runs presses"]],
    centers: Mapping[str, Float[np.ndarray, "presses 3"]],
    *,
    target: float | None = None,
    balls: Sequence[Sphere] = (),
    radius_mm: float = 1.0,
    outline_mm: float | None = None,
) -> Figure:
    """Return a figure of the error by number of presses, and of their positions, by rule.

    Lines are means over runs, bands their range.

    Args:
        curves: Error of each run after 1, 2, ... presses by rule, (runs, presses).
        centers: Centres of the presses of one run by rule, in order, (presses, 3) mm.
        target: Error that is marked by a line.
        balls: True inclusions, drawn in the maps.
        radius_mm: Radius of the sensor, mm.
        outline_mm: Radius of the outline of the body around the origin, mm.
    """
    require_curves("sampling_figure", curves)
    figure = new_figure(max(2.4 * len(centers), 6.0), 6.8 if centers else 4.0)
    ratios = [1.5, 1.0] if centers else [1.5]
    rows = figure.add_gridspec(len(ratios), 1, height_ratios=ratios)
    axes = figure.add_subfigure(rows[0]).subplots()
    for name, runs in curves.items():
        presses = np.arange(1, runs.shape[1] + 1)
        (line,) = axes.plot(presses, runs.mean(axis=0), marker="o", markersize=4, label=name)
        if len(runs) > 1:
            low, high = runs.min(axis=0), runs.max(axis=0)
            axes.fill_between(presses, low, high, color=line.get_color(), alpha=0.1, linewidth=0)
    if target is not None:
        axes.axhline(target, color="0.4", linestyle="--", linewidth=1, label="target")
    axes.set(xlabel="presses", ylabel="RMS error of log E, by volume")
    add_legend(axes)
    if centers:
        panels = figure.add_subfigure(rows[1]).subplots(1, len(centers), squeeze=False)[0]
        for axes, (name, points) in zip(panels, centers.items(), strict=True):
            for ball in balls:
                x, y, _ = ball.center_mm
                axes.fill(*_circle(x, y, float(ball.radius_mm)), color="tab:red", alpha=0.3)
            if outline_mm is not None:
                axes.plot(*_circle(0.0, 0.0, outline_mm), color="0.5", linewidth=1)
            _draw_positions(axes, points, radius_mm)
            axes.set_title(name, fontsize=9)
        panels[0].set_ylabel("y (mm)")
    return figure


def _draw_positions(axes: Axes, centers: np.ndarray, radius_mm: float) -> None:
    for k, (x, y, _) in enumerate(centers, start=1):
        axes.plot(*_circle(x, y, radius_mm), color="tab:blue", linewidth=0.6)
        axes.text(x, y, str(k), ha="center", va="center", fontsize=8)
    axes.set_aspect("equal")
    axes.set_xlabel("x (mm)", fontsize=9)
    axes.tick_params(labelsize=8)


def _circle(x: float, y: float, radius_mm: float) -> tuple[np.ndarray, np.ndarray]:
    return x + radius_mm * np.cos(_ANGLES), y + radius_mm * np.sin(_ANGLES)

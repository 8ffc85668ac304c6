"""Figures in the form of the paper's: rows of slices, box plots, matrices, curves."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.colors import Normalize

from tactorch.errors import ConfigError
from tactorch.mesh import TetMesh
from tactorch.viz.figure import (
    BLUE,
    GREEN,
    MODULUS_LABEL,
    VERMILION,
    new_figure,
    require_curves,
    save_figure,
)
from tactorch.viz.learning import draw_matrix
from tactorch.viz.slicing import slice_body

_PIXELS, _INCHES = 90, 1.55
_LINES = ((BLUE, "-"), (VERMILION, "--"), (GREEN, "-."), ("black", ":"))


@dataclass(frozen=True, eq=False)
class Panel:
    """One slice.

    Attributes:
        mesh: Mesh of the body.
        values: Value of each element, MPa (m,).
        limits: Ends of the colour scale, MPa.
        axis: Axis normal to the slice, which is in the middle of the body.
        title: Text above the panel.
        caption: Text below the panel.
        marks_mm: Points that are numbered, projected along the axis, (k, 3) mm.
    """

    mesh: TetMesh
    values: Float[np.ndarray, " m"]
    limits: tuple[float, float]
    axis: int = 1
    title: str = ""
    caption: str = ""
    marks_mm: Float[np.ndarray, "k 3"] | None = None


def plot_panels(rows: Sequence[Sequence[Panel]], names: Sequence[str], path: str | Path) -> Path:
    """Draw named rows of slices, with a colour bar if all have the same limits.

    Args:
        rows: Panels of each row.
        names: Name of each row.
        path: Path of the png, pdf or svg file.

    Returns:
        The path.

    Raises:
        ConfigError: There is no row, or one is empty.
    """
    if not rows or not all(rows):
        raise ConfigError("plot_panels: a row is empty; give each at least one panel.")
    columns = max(len(row) for row in rows)
    figure = new_figure(_INCHES * columns + 1.3, _INCHES * len(rows) * 1.25 + 0.3)
    grid = figure.subplots(len(rows), columns, squeeze=False)
    for row, name, line in zip(rows, names, grid, strict=True):
        for panel, axes in zip(row, line, strict=False):
            _draw(axes, panel)
        for axes in line[len(row) :]:
            axes.remove()
        line[0].set_ylabel(name, fontsize=9)
    limits = {panel.limits for row in rows for panel in row}
    if len(limits) == 1:
        used = [axes for line, row in zip(grid, rows, strict=True) for axes in line[: len(row)]]
        figure.colorbar(used[0].images[0], ax=used, label=MODULUS_LABEL, aspect=40, pad=0.02)
    return save_figure(figure, path)


def _draw(axes: Axes, panel: Panel) -> None:
    (middle,) = slice_body(panel.mesh, 1, _PIXELS)[panel.axis]
    middle.draw(axes, panel.values, cmap="viridis", norm=Normalize(*panel.limits))
    if panel.marks_mm is not None:
        across = [i for i in range(3) if i != panel.axis]
        for number, (x, y) in enumerate(panel.marks_mm[:, across], start=1):
            axes.text(x, y, str(number), color=VERMILION, fontsize=8, ha="center", va="center")
    axes.set(xticks=[], yticks=[])
    axes.set_title(panel.title, fontsize=8)
    axes.set_xlabel(panel.caption, fontsize=7)


def plot_boxes(
    estimates: Mapping[float, Sequence[float]], path: str | Path, *, reference: str = ""
) -> Path:
    """Draw box plots of estimated against true depths (Fig. 10 of the paper).

    Whiskers extend to the minimum and maximum; dots are samples.

    Args:
        estimates: Estimated depths by true depth, mm.
        path: Path of the png, pdf or svg file.
        reference: Title of the figure.

    Returns:
        The path.

    Raises:
        ConfigError: A depth has no estimate.
    """
    if not estimates or not all(estimates.values()):
        raise ConfigError("plot_boxes: a depth has no estimate.")
    figure = new_figure(5.4, 4.4)
    axes = figure.subplots()
    depths = sorted(estimates)
    axes.plot([depths[0] - 1, depths[-1] + 1], [depths[0] - 1, depths[-1] + 1], color="0.7")
    axes.boxplot(
        [list(estimates[depth]) for depth in depths],
        positions=depths,
        widths=0.5,
        whis=(0, 100),
        manage_ticks=False,
        medianprops={"color": VERMILION},
        boxprops={"color": BLUE},
    )
    for depth in depths:
        samples = estimates[depth]
        positions = depth + np.linspace(-0.15, 0.15, len(samples))
        axes.plot(positions, samples, ".", color=BLUE, markersize=3, alpha=0.6)
    axes.set(xlabel="true depth (mm)", ylabel="estimated depth (mm)", aspect="equal")
    axes.set_xticks(depths)
    axes.set_yticks(depths)
    axes.grid(True, alpha=0.3)
    axes.set_title(reference, fontsize=9)
    return save_figure(figure, path)


def plot_matrices(
    matrices: Mapping[str, tuple[Float[np.ndarray, "c c"], Sequence[str]]],
    path: str | Path,
    *,
    digits: int = 2,
) -> Path:
    """Draw matrices of fractions or similarities side by side (Fig. 11 of the paper).

    Args:
        matrices: Values, 0 to 1, and the names of rows and columns by title.
        path: Path of the png, pdf or svg file.
        digits: Number of decimals of the cells.

    Returns:
        The path.

    Raises:
        ConfigError: There is no matrix.
    """
    if not matrices:
        raise ConfigError("plot_matrices: no matrix given.")
    figure = new_figure(3.4 * len(matrices), 3.4)
    panels = figure.subplots(1, len(matrices), squeeze=False)[0]
    for axes, (title, (values, names)) in zip(panels, matrices.items(), strict=True):
        cells = (f"{value:.{digits}f}" for value in values.ravel())
        draw_matrix(axes, values, names, cells, fontsize=9)
        axes.tick_params(labelsize=8)
        for label in axes.get_yticklabels():
            label.set(rotation=90, va="center")
        axes.set_title(title, fontsize=9)
    return save_figure(figure, path)


def plot_curves(
    panels: Mapping[str, Mapping[str, Float[np.ndarray, " k"]]],
    path: str | Path,
    *,
    columns: int,
    across: str,
    up: str,
) -> Path:
    """Draw curves over the relative depth, one panel per title (Fig. 8 of the paper).

    Args:
        panels: Values of equal layers, the top one first, by title and label.
        path: Path of the png, pdf or svg file.
        columns: Number of panels side by side.
        across: Label of the horizontal axes.
        up: Label of the vertical axes.

    Returns:
        The path.

    Raises:
        ConfigError: There is no panel, or one has no curve.
    """
    require_curves("plot_curves", panels)
    rows = -(-len(panels) // columns)
    figure = new_figure(3.6 * columns, 2.9 * rows)
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    for axes, (title, curves) in zip(grid.ravel(), panels.items(), strict=False):
        for i, (name, values) in enumerate(curves.items()):
            depths = (np.arange(len(values)) + 0.5) / len(values)
            colour, style = _LINES[i % len(_LINES)]
            axes.plot(depths, values, style, color=colour, marker="o", markersize=2.5, label=name)
        axes.set_title(title, fontsize=9)
        axes.grid(True, alpha=0.3)
        axes.legend(frameon=False, fontsize=7)
    for axes in grid[-1]:
        axes.set_xlabel(across, fontsize=9)
    for line in grid:
        line[0].set_ylabel(up, fontsize=9)
    return save_figure(figure, path)

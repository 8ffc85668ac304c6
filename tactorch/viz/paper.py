"""Figures in the form of the paper's: rows of slices, box plots, matrices, curves."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from tactorch.errors import ConfigError
from tactorch.mesh import TetMesh
from tactorch.viz.figure import (
    BLUE,
    MODULUS_LABEL,
    VERMILION,
    draw_depth_curves,
    new_axes,
    new_grid,
    require_curves,
)
from tactorch.viz.learning import draw_matrix
from tactorch.viz.slicing import IN_PLANE, cut, even_planes

_PIXELS, _INCHES = 90, 1.55


@dataclass(frozen=True, eq=False)
class Panel:
    """Slice across `axis` through the middle of a body, of the moduli of its elements, MPa.

    Points `marks_mm` are numbered, projected along the axis.
    """

    mesh: TetMesh
    values: Float[np.ndarray, " m"]
    limits: tuple[float, float]
    axis: int = 1
    title: str = ""
    caption: str = ""
    marks_mm: Float[np.ndarray, "k 3"] | None = None

    def draw(self, axes: Axes) -> None:
        """Draw the slice with its title above and its caption below."""
        (middle,) = cut(self.mesh, even_planes(self.mesh, self.axis), _PIXELS)
        middle.draw(axes, self.values, cmap="viridis", norm=Normalize(*self.limits))
        if self.marks_mm is not None:
            for number, (x, y) in enumerate(self.marks_mm[:, IN_PLANE[self.axis]], start=1):
                axes.text(x, y, str(number), color=VERMILION, fontsize=8, ha="center", va="center")
        axes.set(xticks=[], yticks=[])
        axes.set_title(self.title, fontsize=8)
        axes.set_xlabel(self.caption, fontsize=7)


def panels_figure(rows: Mapping[str, Sequence[Panel]]) -> Figure:
    """Return a figure of named rows of slices, with a colour bar if all have the same limits."""
    if not rows or not all(rows.values()):
        raise ConfigError("panels_figure: a row is empty; give each at least one panel.")
    columns = max(len(row) for row in rows.values())
    size = _INCHES * columns + 1.3, _INCHES * len(rows) * 1.25 + 0.3
    figure, grid = new_grid(*size, len(rows), columns)
    used = []
    for (name, row), line in zip(rows.items(), grid, strict=True):
        for panel, axes in zip(row, line, strict=False):
            panel.draw(axes)
            used.append(axes)
        for axes in line[len(row) :]:
            axes.remove()
        line[0].set_ylabel(name, fontsize=9)
    if len({panel.limits for row in rows.values() for panel in row}) == 1:
        figure.colorbar(used[0].images[0], ax=used, label=MODULUS_LABEL, aspect=40, pad=0.02)
    return figure


def boxes_figure(estimates: Mapping[float, Sequence[float]], *, title: str = "") -> Figure:
    """Return a figure with box plots of estimated by true depths, mm (Fig. 10 of the paper).

    Whiskers extend to the minimum and maximum; dots are samples.
    """
    if not estimates or not all(estimates.values()):
        raise ConfigError("boxes_figure: a depth has no estimate.")
    figure, axes = new_axes(5.4, 4.4)
    depths = sorted(estimates)
    ends = [depths[0] - 1, depths[-1] + 1]
    axes.plot(ends, ends, color="0.7")
    axes.boxplot(
        [list(estimates[depth]) for depth in depths], positions=depths, widths=0.5, whis=(0, 100),
        manage_ticks=False, medianprops={"color": VERMILION}, boxprops={"color": BLUE},
    )  # fmt: skip
    for depth in depths:
        positions = depth + np.linspace(-0.15, 0.15, len(estimates[depth]))
        axes.plot(positions, estimates[depth], ".", color=BLUE, markersize=3, alpha=0.6)
    axes.set(xlabel="true depth (mm)", ylabel="estimated depth (mm)", aspect="equal")
    axes.set(xticks=depths, yticks=depths)
    axes.grid(True, alpha=0.3)
    axes.set_title(title, fontsize=9)
    return figure


def matrices_figure(
    matrices: Mapping[str, tuple[Float[np.ndarray, "c c"], Sequence[str]]],
) -> Figure:
    """Return a figure of matrices side by side (Fig. 11 of the paper).

    Matrices are given by title: values from 0 to 1, and names of rows and columns.
    """
    if not matrices:
        raise ConfigError("matrices_figure: no matrix given.")
    figure, grid = new_grid(3.4 * len(matrices), 3.4, 1, len(matrices))
    for axes, (title, (values, names)) in zip(grid[0], matrices.items(), strict=True):
        draw_matrix(axes, values, names, (f"{value:.2f}" for value in values.ravel()), fontsize=9)
        axes.tick_params(labelsize=8)
        for label in axes.get_yticklabels():
            label.set(rotation=90, va="center")
        axes.set_title(title, fontsize=9)
    return figure


def curves_figure(
    panels: Mapping[str, Mapping[str, Float[np.ndarray, " k"]]], columns: int, ylabel: str
) -> Figure:
    """Return a figure of curves over the relative depth (Fig. 8 of the paper).

    Panels are given by title: values of equal layers, the top one first, by label.
    """
    require_curves("curves_figure", panels)
    rows = -(-len(panels) // columns)
    figure, grid = new_grid(3.6 * columns, 2.9 * rows, rows, columns, sharex=True, sharey=True)
    draw_depth_curves(grid, panels, ylabel)
    return figure

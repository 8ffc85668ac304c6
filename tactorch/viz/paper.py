"""Pictures in the form of the paper's figures: rows of slices, box plots, matrices, curves."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.colors import Normalize

from tactorch.errors import ConfigError
from tactorch.mesh import TetMesh
from tactorch.viz._figure import new_figure, save_figure
from tactorch.viz.sampling import slice_body
from tactorch.viz.slices import LABEL

_PIXELS, _INCHES = 90, 1.55
_BLUE, _ORANGE = "#0072B2", "#D55E00"  # told apart by those who do not see red from green
_LINES = ((_BLUE, "-"), (_ORANGE, "--"), ("#009E73", "-."), ("black", ":"))


@dataclass(frozen=True, eq=False)
class Panel:
    """One slice.

    Attributes:
        mesh: The body.
        values: Of each element, MPa (m,).
        limits: Ends of the colours, MPa.
        axis: That it cuts across, in the middle.
        title: Above it.
        caption: Below it.
        marks_mm: Points to mark, projected along the axis, (k, 3), mm.
    """

    mesh: TetMesh
    values: Float[np.ndarray, " m"]
    limits: tuple[float, float]
    axis: int = 1
    title: str = ""
    caption: str = ""
    marks_mm: Float[np.ndarray, "k 3"] | None = None


def plot_panels(rows: Sequence[Sequence[Panel]], names: Sequence[str], path: str | Path) -> Path:
    """Draw rows of slices, each under its name; a colour bar serves all of the same limits.

    Raises:
        ConfigError: There is nothing to draw.
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
        kept = [axes for line, row in zip(grid, rows, strict=True) for axes in line[: len(row)]]
        figure.colorbar(kept[0].images[0], ax=kept, label=LABEL, aspect=40, pad=0.02)
    return save_figure(figure, path)


def _draw(axes: Axes, panel: Panel) -> None:
    (middle,) = slice_body(panel.mesh, 1, _PIXELS)[panel.axis]
    axes.imshow(
        middle.values(panel.values),
        extent=middle.extent_mm,
        origin="lower",
        cmap="viridis",
        norm=Normalize(*panel.limits),
        interpolation="nearest",
    )
    if panel.marks_mm is not None:
        across = [i for i in range(3) if i != panel.axis]
        for number, (x, y) in enumerate(panel.marks_mm[:, across], start=1):
            axes.text(x, y, str(number), color=_ORANGE, fontsize=8, ha="center", va="center")
    axes.set(xticks=[], yticks=[])
    axes.set_title(panel.title, fontsize=8)
    axes.set_xlabel(panel.caption, fontsize=7)


def plot_boxes(
    estimates: Mapping[float, Sequence[float]], path: str | Path, *, reference: str = ""
) -> Path:
    """Draw box plots of estimated depths over the true ones (Fig. 10), mm.

    Whiskers reach the least and the largest; each sample is a dot.

    Raises:
        ConfigError: There is no estimate.
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
        medianprops={"color": _ORANGE},
        boxprops={"color": _BLUE},
    )
    for depth in depths:
        found = estimates[depth]
        aside = depth + np.linspace(-0.15, 0.15, len(found))
        axes.plot(aside, found, ".", color=_BLUE, markersize=3, alpha=0.6)
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
    """Draw matrices of shares or similarities, 0 to 1, beside one another (Fig. 11).

    Raises:
        ConfigError: There is none.
    """
    if not matrices:
        raise ConfigError("plot_matrices: no matrix given.")
    figure = new_figure(3.4 * len(matrices), 3.4)
    panels = figure.subplots(1, len(matrices), squeeze=False)[0]
    for axes, (title, (values, names)) in zip(panels, matrices.items(), strict=True):
        axes.imshow(values, cmap="cividis", vmin=0.0, vmax=1.0)
        for i, j in np.ndindex(*values.shape):
            colour = "black" if values[i, j] > 0.5 else "white"
            text = f"{values[i, j]:.{digits}f}"
            axes.text(j, i, text, ha="center", va="center", color=colour, fontsize=9)
        axes.set_xticks(range(len(names)), list(names), fontsize=8)
        axes.set_yticks(range(len(names)), list(names), fontsize=8, rotation=90, va="center")
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
    """Draw curves over the depth from 0 to 1, a panel a title (Fig. 8).

    Raises:
        ConfigError: There is no curve.
    """
    if not panels or not all(panels.values()):
        raise ConfigError("plot_curves: a panel has no curve.")
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

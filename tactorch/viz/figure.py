"""Figures without a display: creation, text from files, styles and atomic saving."""

import io
from collections.abc import Mapping
from itertools import cycle
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import LogFormatter

from tactorch.errors import ConfigError
from tactorch.files import atomic_path
from tactorch.text import printable

FORMATS = (".png", ".pdf", ".svg")
#: Okabe and Ito's colours, which colour-blind readers can distinguish.
BLUE, VERMILION, GREEN, PURPLE = "#0072B2", "#D55E00", "#009E73", "#CC79A7"
COLOURS = (BLUE, VERMILION, GREEN, PURPLE, "#E69F00", "#56B4E9", "#000000")
#: Colour of contact: differs from every colour of viridis and cividis.
CONTACT = VERMILION
_NOTEBOOK_DPI = 90
_LINES = ((BLUE, "-"), (VERMILION, "--"), (GREEN, "-."), ("black", ":"))
MODULUS_LABEL = "Young's modulus (MPa)"


class PlainTextFigure(Figure):
    """Figure whose text is never parsed as mathtext, except the labels of logarithmic axes."""

    def draw(self, renderer: Any) -> None:
        """Draw the figure; see `matplotlib.figure.Figure.draw`."""
        generated = {
            id(label)
            for axes in self.axes
            for axis in (axes.xaxis, axes.yaxis)
            if isinstance(axis.get_major_formatter(), LogFormatter)
            for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks())
            for label in (tick.label1, tick.label2)
        }
        for text in self.findobj(Text):
            if isinstance(text, Text) and id(text) not in generated:
                text.set_parse_math(False)
                text.set_text(printable(text.get_text()))
        super().draw(renderer)

    def _repr_png_(self) -> bytes:
        """Return the picture for a notebook."""
        buffer = io.BytesIO()
        self.savefig(buffer, format="png", dpi=_NOTEBOOK_DPI)
        return buffer.getvalue()


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure of a size in inches that is independent of pyplot's state."""
    figure = PlainTextFigure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def new_grid(
    width: float, height: float, rows: int, columns: int, **options: Any
) -> tuple[Figure, np.ndarray]:
    """Return a figure of a size in inches, and its grid of axes; options are of `subplots`."""
    figure = new_figure(width, height)
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


def new_axes(width: float, height: float) -> tuple[Figure, Axes]:
    """Return a figure of a size in inches, and its only axes."""
    figure = new_figure(width, height)
    return figure, figure.subplots()


def save_figure(figure: Figure, path: str | Path, dpi: int = 130) -> Path:
    """Write a figure atomically and return the path, whose suffix gives the format.

    Raises:
        ConfigError: The suffix is none of png, pdf and svg.
    """
    target = Path(path)
    if target.suffix.lower() not in FORMATS:
        raise ConfigError(f"'{target}': a picture's name ends in one of {', '.join(FORMATS)}.")
    with atomic_path(target) as temporary:
        figure.savefig(temporary, dpi=dpi)
    return target


def require_curves(function: str, curves: Mapping[str, Any]) -> None:
    """Raise `ConfigError` if there is no curve, or a group of curves is empty."""
    groups = [value for value in curves.values() if isinstance(value, Mapping)]
    if not curves or not all(groups):
        raise ConfigError(f"{function}: no curve given; pass at least one.")


def add_legend(axes: Axes, fontsize: float | None = 8) -> None:
    """Add a grid and a legend without a frame."""
    axes.grid(True, alpha=0.3)
    axes.legend(frameon=False, fontsize=fontsize)


def draw_diagonal(axes: Axes) -> None:
    """Draw the line of exact probabilities from (0, 0) to (1, 1)."""
    axes.plot([0, 1], [0, 1], "--", color="0.5", linewidth=1, label="exact")
    axes.set(xlim=(0, 1), ylim=(0, 1))


def draw_depth_curves(
    grid: np.ndarray,
    panels: Mapping[str, Mapping[str, np.ndarray]],
    ylabel: str,
    yscale: Literal["linear", "log"] = "linear",
) -> None:
    """Draw panels, by title, of values of equal layers by label, the top layer first."""
    for axes, (title, curves) in zip(grid.ravel(), panels.items(), strict=False):
        for (name, values), (colour, style) in zip(curves.items(), cycle(_LINES), strict=False):
            depths = (np.arange(len(values)) + 0.5) / len(values)
            axes.plot(depths, values, style, color=colour, marker="o", markersize=3, label=name)
        axes.set_yscale(yscale)
        axes.set_title(title, fontsize=9)
        add_legend(axes)
    for axes in grid[-1]:
        axes.set_xlabel("depth (fraction of the height)", fontsize=9)
    for line in grid:
        line[0].set_ylabel(ylabel, fontsize=9)

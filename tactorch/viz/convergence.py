"""How the misfit fell: one curve per optimizer, against iterations and against time."""

import math
from collections.abc import Mapping, Sequence
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, ScalarFormatter

from tactorch.errors import ConfigError
from tactorch.viz._figure import new_figure, save_figure

_FIELDS = ("iteration", "seconds", "misfit")
# Okabe and Ito's colours, told apart by colour-blind readers; styles serve print in grey.
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
_STYLES = ("-", "--", "-.", ":")
_MARKERS = ("o", "s", "^", "D", "v", "P", "X")

History = Sequence[Mapping[str, Any]]


def plot_convergence(
    histories: Mapping[str, History],
    path: str | Path,
    *,
    noise_level: float | None = None,
    title: str = "",
) -> Path:
    """Draw `convergence_figure` to a file (png, pdf or svg) and return its path."""
    return save_figure(convergence_figure(histories, noise_level=noise_level, title=title), path)


def convergence_figure(
    histories: Mapping[str, History], *, noise_level: float | None = None, title: str = ""
) -> Figure:
    """Draw the misfit of each optimizer against iterations (left) and seconds (right).

    Args:
        histories: Per optimizer, its records in order, each with the keys `iteration`,
            `seconds` and `misfit` (further keys are left alone).
        noise_level: Misfit that the noise alone would leave; drawn as a line.
        title: Printed above.

    Raises:
        ConfigError: No history, an empty one, or a record that lacks a number.
    """
    if not histories:
        raise ConfigError("plot_convergence: no history given; pass at least one optimizer's.")
    curves = {name: _curve(name, history) for name, history in histories.items()}
    figure = new_figure(9.5, 4.2)
    left, right = figure.subplots(1, 2, sharey=True)
    for axes, column, label in ((left, 0, "iteration"), (right, 1, "time (s)")):
        _draw(axes, curves, column)
        axes.set_xlabel(label)
        axes.grid(True, which="major", alpha=0.3)
        if noise_level is not None:
            axes.axhline(noise_level, color="0.35", linewidth=1, linestyle=(0, (1, 2)))
    left.set_ylabel("misfit (mm²)")
    _iteration_scale(left, [curve[-1, 0] for curve in curves.values()])
    if noise_level is not None:
        place = {"xy": (0.98, noise_level), "xycoords": ("axes fraction", "data")}
        right.annotate("noise level", **place, ha="right", va="bottom", color="0.35", fontsize=9)
    right.legend(frameon=False)
    if title:
        figure.suptitle(title)
    return figure


def _iteration_scale(axes: Axes, last: Sequence[float]) -> None:
    """Keep a method of few iterations readable beside one of hundreds."""
    if max(last) > 8 * max(min(last), 1):
        axes.set_xscale("symlog", linthresh=1)
        axes.set_xlim(-0.2, 1.3 * max(last))
        axes.xaxis.set_major_formatter(ScalarFormatter())
    else:
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))


def _draw(axes: Axes, curves: Mapping[str, np.ndarray], column: int) -> None:
    """Draw every curve's misfit against one of its first two columns."""
    looks = zip(cycle(_COLOURS), cycle(_STYLES), cycle(_MARKERS), strict=False)
    for (name, curve), (colour, style, marker) in zip(curves.items(), looks, strict=False):
        # A few markers suffice to tell the curves apart.
        every = max(1, len(curve) // 12)
        axes.semilogy(
            curve[:, column],
            curve[:, 2],
            color=colour,
            linestyle=style,
            marker=marker,
            markevery=every,
            markersize=4.5,
            label=name,
        )


def _curve(name: str, history: History) -> np.ndarray:
    """Return (records, 3): iteration, seconds and misfit, all finite."""
    if len(history) == 0:
        raise ConfigError(f"history '{name}' is empty; it needs at least one record.")
    return np.array([_record(name, index, record) for index, record in enumerate(history)])


def _record(name: str, index: int, record: Mapping[str, Any]) -> list[float]:
    """Return the three numbers of one record."""
    missing = [field for field in _FIELDS if field not in record]
    if missing:
        raise ConfigError(f"history '{name}', record {index}: no field '{missing[0]}'.")
    values = [float(record[field]) for field in _FIELDS]
    for field, value in zip(_FIELDS, values, strict=True):
        if not math.isfinite(value):
            raise ConfigError(f"history '{name}', record {index}: {field} is {value}, no number.")
    return values

"""Convergence of the misfit: one curve per optimizer, against iterations and time."""

import math
from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, ScalarFormatter

from tactorch.errors import ConfigError
from tactorch.inverse import Reconstruction
from tactorch.text import one_line
from tactorch.viz.figure import COLOURS, new_figure

_STYLES = ("-", "--", "-.", ":")  # distinguish curves in greyscale prints
_MARKERS = ("o", "s", "^", "D", "v", "P", "X")

History = Sequence[Mapping[str, Any]]


def convergence_figure(
    histories: Mapping[str, History] | Reconstruction,
    *,
    noise_level: float | None = None,
    title: str = "",
) -> Figure:
    """Return a figure of the misfit of each optimizer against iterations and seconds.

    Args:
        histories: The result of an inversion; or records of each optimizer in order, with the keys
            `iteration`, `seconds` and `misfit`. Where no displacement is measured, so that all
            misfits are zero, `chi2` is drawn; other keys are ignored.
        noise_level: Expected misfit of the noise, mm^2, drawn as a line.
        title: Title of the figure.

    Raises:
        ConfigError: There is no history, one is empty, or a record lacks a finite number.
    """
    if isinstance(histories, Reconstruction):
        histories = {"inversion": histories.history}
    if not histories:
        raise ConfigError("convergence_figure: no history given; pass at least one optimizer's.")
    forces = not any(r.get("misfit", 1.0) for history in histories.values() for r in history)
    fields = ("iteration", "seconds", "chi2" if forces else "misfit")
    curves = {name: _curve(name, history, fields) for name, history in histories.items()}
    figure = new_figure(9.5, 4.2)
    left, right = figure.subplots(1, 2, sharey=True)
    for axes, column, label in ((left, 0, "iteration"), (right, 1, "time (s)")):
        styles = zip(cycle(COLOURS), cycle(_STYLES), cycle(_MARKERS), strict=False)
        for (name, curve), (colour, style, marker) in zip(curves.items(), styles, strict=False):
            axes.semilogy(
                curve[:, column], curve[:, 2], color=colour, linestyle=style, marker=marker,
                markevery=max(1, len(curve) // 12), markersize=4.5, label=one_line(name, 40),
            )  # fmt: skip
        axes.set_xlabel(label)
        axes.grid(True, which="major", alpha=0.3)
        if noise_level is not None:
            axes.axhline(noise_level, color="0.35", linewidth=1, linestyle=(0, (1, 2)))
    left.set_ylabel("mean squared residual (noise: 1)" if forces else "misfit (mm²)")
    _scale_iterations(left, [curve[-1, 0] for curve in curves.values()])
    if noise_level is not None:
        right.annotate(
            "noise level", xy=(0.98, noise_level), xycoords=("axes fraction", "data"), ha="right",
            va="bottom", color="0.35", fontsize=9,
        )  # fmt: skip
    right.legend(frameon=False)
    if title:
        figure.suptitle(title)
    return figure


def _scale_iterations(axes: Axes, last: Sequence[float]) -> None:
    """Use a logarithmic scale if the numbers of iterations differ strongly."""
    if max(last) > 8 * max(min(last), 1):
        axes.set_xscale("symlog", linthresh=1)
        axes.set_xlim(-0.2, 1.3 * max(last))
        axes.xaxis.set_major_formatter(ScalarFormatter())
    else:
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))


def _curve(name: str, history: History, fields: Sequence[str]) -> np.ndarray:
    """Return some fields of each record, (records, fields)."""
    if len(history) == 0:
        raise ConfigError(f"history '{name}' is empty; it needs at least one record.")
    for index, record in enumerate(history):
        for field in fields:
            if field not in record:
                raise ConfigError(f"history '{name}', record {index}: no field '{field}'.")
            if not math.isfinite(record[field]):
                raise ConfigError(
                    f"history '{name}', record {index}: {field} is {record[field]}, no number."
                )
    return np.array([[float(record[field]) for field in fields] for record in history])

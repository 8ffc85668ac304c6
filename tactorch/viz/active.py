"""Pictures of active sampling: error against presses, and the places pressed."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tactorch.errors import ConfigError
from tactorch.mesh import Sphere
from tactorch.viz._figure import new_figure, save_figure

_ROUND = np.linspace(0.0, 2.0 * np.pi, 73)


def plot_sampling(
    curves: Mapping[str, Float[np.ndarray, "runs presses"]],
    places: Mapping[str, Float[np.ndarray, "presses 3"]],
    path: str | Path,
    *,
    target: float | None = None,
    balls: Sequence[Sphere] = (),
    radius_mm: float = 1.0,
    outline_mm: float | None = None,
) -> Path:
    """Draw `sampling_figure` to a file (png, pdf or svg) and return its path."""
    figure = sampling_figure(
        curves, places, target=target, balls=balls, radius_mm=radius_mm, outline_mm=outline_mm
    )
    return save_figure(figure, path)


def sampling_figure(
    curves: Mapping[str, Float[np.ndarray, "runs presses"]],
    places: Mapping[str, Float[np.ndarray, "presses 3"]],
    *,
    target: float | None = None,
    balls: Sequence[Sphere] = (),
    radius_mm: float = 1.0,
    outline_mm: float | None = None,
) -> Figure:
    """Draw errors against presses by rule, above the places each rule pressed, from above.

    The line is the mean over runs, the band from the least to the largest of them.

    Args:
        curves: Per rule, the error of each run after 1, 2, ... presses.
        places: Per rule, centres of the presses of one run in turn, mm.
        target: An error to mark.
        balls: True inclusions, outlined in the maps.
        radius_mm: Of the sensor, for the size of its marks.
        outline_mm: Radius of the body's outline around the origin.

    Raises:
        ConfigError: no curve is given.
    """
    if not curves:
        raise ConfigError("sampling_figure: no curve given; pass at least one rule's.")
    figure = new_figure(max(2.4 * len(places), 6.0), 6.8 if places else 4.0)
    rows = figure.add_gridspec(2 if places else 1, 1, height_ratios=[1.5, 1.0][: 1 + bool(places)])
    _draw_curves(figure.add_subfigure(rows[0]).subplots(), curves, target)
    if places:
        panels = figure.add_subfigure(rows[1]).subplots(1, len(places), squeeze=False)[0]
        for axes, (name, centers) in zip(panels, places.items(), strict=True):
            _draw_places(axes, centers, balls, radius_mm, outline_mm)
            axes.set_title(name, fontsize=9)
        panels[0].set_ylabel("y (mm)")
    return figure


def _draw_curves(axes: Axes, curves: Mapping[str, np.ndarray], target: float | None) -> None:
    for name, runs in curves.items():
        presses = np.arange(1, runs.shape[1] + 1)
        (line,) = axes.plot(presses, runs.mean(axis=0), marker="o", markersize=4, label=name)
        if len(runs) > 1:
            low, high = runs.min(axis=0), runs.max(axis=0)
            axes.fill_between(presses, low, high, color=line.get_color(), alpha=0.1, linewidth=0)
    if target is not None:
        axes.axhline(target, color="0.4", linestyle="--", linewidth=1, label="target")
    axes.set_xlabel("presses")
    axes.set_ylabel("RMS error of log E, by volume")
    axes.grid(True, alpha=0.3)
    axes.legend(frameon=False, fontsize=8)


def _draw_places(
    axes: Axes,
    centers: np.ndarray,
    balls: Sequence[Sphere],
    radius_mm: float,
    outline_mm: float | None,
) -> None:
    """Draw the places from above, numbered in turn, over the true inclusions."""
    cos, sin = np.cos(_ROUND), np.sin(_ROUND)
    for ball in balls:
        x, y, _ = ball.center_mm
        axes.fill(x + ball.radius_mm * cos, y + ball.radius_mm * sin, color="tab:red", alpha=0.3)
    if outline_mm is not None:
        axes.plot(outline_mm * cos, outline_mm * sin, color="0.5", linewidth=1)
    for k, (x, y, _) in enumerate(centers, start=1):
        axes.plot(x + radius_mm * cos, y + radius_mm * sin, color="tab:blue", linewidth=0.6)
        axes.text(x, y, str(k), ha="center", va="center", fontsize=8)
    axes.set_aspect("equal")
    axes.set_xlabel("x (mm)", fontsize=9)
    axes.tick_params(labelsize=8)

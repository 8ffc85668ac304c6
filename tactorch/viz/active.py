"""Figures of active sampling: error against presses, and the positions of the presses."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tactorch.mesh import Sphere
from tactorch.viz.figure import new_figure, require_curves

_ANGLES = np.linspace(0.0, 2.0 * np.pi, 73)


def sampling_figure(
    curves: Mapping[str, Float[np.ndarray, "runs presses"]],
    centers: Mapping[str, Float[np.ndarray, "presses 3"]],
    *,
    target: float | None = None,
    balls: Sequence[Sphere] = (),
    radius_mm: float = 1.0,
    outline_mm: float | None = None,
) -> Figure:
    """Draw the error against the number of presses, and the positions of the presses, by rule.

    Lines are means over runs, bands their range.

    Args:
        curves: Error of each run after 1, 2, ... presses by rule, (runs, presses).
        centers: Centres of the presses of one run by rule, in order, (presses, 3) mm.
        target: Error that is marked by a line.
        balls: True inclusions, drawn in the maps.
        radius_mm: Radius of the sensor, mm.
        outline_mm: Radius of the outline of the body around the origin, mm.

    Returns:
        The figure.

    Raises:
        ConfigError: There is no curve.
    """
    require_curves("sampling_figure", curves)
    figure = new_figure(max(2.4 * len(centers), 6.0), 6.8 if centers else 4.0)
    rows = figure.add_gridspec(
        2 if centers else 1, 1, height_ratios=[1.5, 1.0][: 1 + bool(centers)]
    )
    _draw_curves(figure.add_subfigure(rows[0]).subplots(), curves, target)
    if centers:
        panels = figure.add_subfigure(rows[1]).subplots(1, len(centers), squeeze=False)[0]
        for axes, (name, points) in zip(panels, centers.items(), strict=True):
            _draw_positions(axes, points, balls, radius_mm, outline_mm)
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


def _draw_positions(
    axes: Axes,
    centers: np.ndarray,
    balls: Sequence[Sphere],
    radius_mm: float,
    outline_mm: float | None,
) -> None:
    """Draw the numbered positions from above, over the true inclusions."""
    cos, sin = np.cos(_ANGLES), np.sin(_ANGLES)
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

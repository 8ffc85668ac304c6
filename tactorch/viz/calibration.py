"""Calibration of stated probabilities: intervals, predictive distributions and classifiers."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tactorch.viz.figure import BLUE, new_figure, require_curves, save_figure


def calibration_figure(curves: Mapping[str, Float[np.ndarray, " k"]], *, title: str = "") -> Figure:
    """Draw the coverage of intervals against their level; exact intervals are on the diagonal.

    Args:
        curves: Result of `tactorch.uncertainty.calibration_curve` at its default levels by label.
        title: Title of the figure.

    Returns:
        The figure.

    Raises:
        ConfigError: There is no curve.
    """
    require_curves("calibration_figure", curves)
    figure = new_figure(5.0, 4.6)
    axes = figure.subplots()
    _draw_diagonal(axes)
    for name, covered in curves.items():
        levels = np.linspace(0.05, 0.95, len(covered))
        axes.plot(levels, covered, marker="o", markersize=3, label=name)
    axes.vlines(0.9, 0.85, 0.95, color="black", linewidth=3, label="target at 90 %: 85 to 95 %")
    axes.set(aspect="equal", xlabel="level of the intervals", ylabel="fraction of elements covered")
    axes.grid(True, alpha=0.3)
    axes.legend(frameon=False, fontsize=8)
    axes.set_title(title)
    return figure


def plot_coverage(levels: Sequence[float], covered: Sequence[float], path: str | Path) -> Path:
    """Draw the fraction of voxels within predictive intervals against the level.

    Args:
        levels: Levels of the intervals, 0 to 1.
        covered: Fraction of voxels whose true value is within the interval of each level.
        path: Path of the png, pdf or svg file.

    Returns:
        The path.
    """
    figure = new_figure(4.2, 4.0)
    axes = figure.subplots()
    _draw_diagonal(axes)
    axes.plot(levels, covered, "o-", color=BLUE, label="measured")
    axes.set(xlabel="level of the intervals", ylabel="fraction of voxels covered")
    axes.legend()
    return save_figure(figure, path)


def plot_reliability(
    confidence: Float[np.ndarray, " b"],
    accuracy: Float[np.ndarray, " b"],
    counts: Int[np.ndarray, " b"],
    path: str | Path,
) -> Path:
    """Draw the accuracy of a classifier against its confidence.

    Args:
        confidence: Mean probability of the predicted class in each bin, (b,).
        accuracy: Fraction of correct predictions in each bin, (b,).
        counts: Number of predictions in each bin, (b,); empty bins are omitted.
        path: Path of the png, pdf or svg file.

    Returns:
        The path.
    """
    figure = new_figure(4.2, 4.0)
    axes = figure.subplots()
    _draw_diagonal(axes)
    filled = counts > 0
    axes.plot(confidence[filled], accuracy[filled], "o-", color=BLUE, label="measured")
    for x, y, count in zip(confidence[filled], accuracy[filled], counts[filled], strict=True):
        axes.annotate(str(count), (x, y), textcoords="offset points", xytext=(4, -10), fontsize=7)
    axes.set(xlabel="predicted probability", ylabel="accuracy", ylim=(0, 1.02))
    axes.legend()
    return save_figure(figure, path)


def _draw_diagonal(axes: Axes) -> None:
    axes.plot([0, 1], [0, 1], "--", color="0.5", linewidth=1, label="exact")
    axes.set(xlim=(0, 1), ylim=(0, 1))

"""What a recognizer gets right, and how far it may be believed."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes

from tactorch.viz._figure import new_figure, save_figure


def plot_confusion(
    confusion: Int[np.ndarray, "c c"], classes: Sequence[str], path: str | Path
) -> Path:
    """Draw a confusion matrix: shares of each true class in colour, counts in words."""
    figure = new_figure(1.6 + 0.8 * len(classes), 1.2 + 0.8 * len(classes))
    axes = figure.subplots()
    shares = confusion / np.maximum(confusion.sum(axis=1, keepdims=True), 1)
    axes.imshow(shares, cmap="cividis", vmin=0.0, vmax=1.0)
    for i, j in np.ndindex(*confusion.shape):
        colour = "black" if shares[i, j] > 0.5 else "white"
        axes.text(j, i, f"{confusion[i, j]}", ha="center", va="center", color=colour)
    axes.set_xticks(range(len(classes)), list(classes))
    axes.set_yticks(range(len(classes)), list(classes))
    axes.set(xlabel="named", ylabel="true")
    return save_figure(figure, path)


def plot_reliability(
    confidence: Float[np.ndarray, " b"],
    right: Float[np.ndarray, " b"],
    counts: Int[np.ndarray, " b"],
    path: str | Path,
) -> Path:
    """Draw the share of right answers against the stated probability."""
    figure = new_figure(4.2, 4.0)
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], "--", color="grey", label="as stated")
    some = counts > 0
    axes.plot(confidence[some], right[some], "o-", color="#0072B2", label="measured")
    for x, y, count in zip(confidence[some], right[some], counts[some], strict=True):
        axes.annotate(str(count), (x, y), textcoords="offset points", xytext=(4, -10), fontsize=7)
    axes.set(
        xlabel="stated probability", ylabel="share of right answers", xlim=(0, 1), ylim=(0, 1.02)
    )
    axes.legend()
    return save_figure(figure, path)


def plot_examples(
    maps: Float[np.ndarray, "n v v v"],
    titles: Sequence[str],
    right: Sequence[bool],
    path: str | Path,
    *,
    shown: int = 12,
) -> Path:
    """Draw middle slices of maps with what they were taken for, wrong ones first."""
    order = sorted(range(len(titles)), key=lambda i: bool(right[i]))[:shown]
    columns = min(6, len(order))
    rows = -(-len(order) // columns)
    figure = new_figure(1.7 * columns, 2.0 * rows)
    grid = figure.subplots(rows, columns, squeeze=False)
    for axes, place in zip(grid.ravel(), order, strict=False):
        _draw_map(axes, maps[place], titles[place], right[place])
    for axes in grid.ravel()[len(order) :]:
        axes.remove()
    return save_figure(figure, path)


def _draw_map(axes: Axes, values: Float[np.ndarray, "v v v"], title: str, right: bool) -> None:
    """The slice across y in the middle, upright."""
    axes.imshow(values[:, values.shape[1] // 2].T, origin="lower", cmap="viridis")
    axes.set_title(title, fontsize=7, color="black" if right else "#D55E00")
    axes.set(xticks=[], yticks=[])

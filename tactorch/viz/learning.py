"""Figures of datasets and of trained networks: samples, recognizer, surrogate."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int
from matplotlib.axes import Axes

from tactorch.errors import ConfigError
from tactorch.generation import Sample
from tactorch.text import one_line
from tactorch.viz.figure import VERMILION, new_figure, save_figure
from tactorch.viz.slicing import slice_body

_MAX_SAMPLES = 6
_PIXELS = 80
_MAX_NAME = 24


def plot_samples(samples: Sequence[Sample], path: str | Path) -> Path:
    """Draw middle slices of some samples, and histograms of moduli and signals of all.

    Args:
        samples: Samples of a dataset, at least one.
        path: Path of the png, pdf or svg file.

    Returns:
        The path.

    Raises:
        ConfigError: There is no sample, or the suffix is none of these.
    """
    if not samples:
        raise ConfigError("there is no sample to draw; generate some first.")
    shown = samples[:: max(1, len(samples) // _MAX_SAMPLES)][:_MAX_SAMPLES]
    reconstructed = any(sample.reconstruction is not None for sample in shown)
    names = ("truth", "reconstruction") if reconstructed else ("truth",)
    figure = new_figure(2.0 * _MAX_SAMPLES, 2.2 * (len(names) + 1))
    grid = figure.subplots(len(names) + 1, _MAX_SAMPLES, squeeze=False)
    for column, sample in enumerate(shown):
        (middle,) = slice_body(sample.recording.mesh, 1, _PIXELS)[1]
        maps = (sample.truth, sample.reconstruction)
        for axes, values in zip(grid[: len(names), column], maps, strict=False):
            if values is not None:
                middle.draw(axes, values, vmin=0.0, vmax=float(sample.truth.max()))
                axes.set(xticks=[], yticks=[])
        label = one_line(sample.label, _MAX_NAME)
        grid[0, column].set_title(f"{sample.index}: {label}", fontsize=8)
    for row, name in enumerate(names):
        grid[row, 0].set_ylabel(name)
    for axes in grid[:-1, len(shown) :].ravel():
        axes.remove()
    _draw_histograms(grid[-1], samples)
    return save_figure(figure, path)


def _draw_histograms(row: np.ndarray, samples: Sequence[Sample]) -> None:
    scores = [sample.figures for sample in samples if sample.figures]
    histograms = {
        "Young's modulus, log10 MPa": np.log10(np.concatenate([s.truth for s in samples])),
        "largest displacement, mm": np.array([s.largest_mm for s in samples]),
        "presses": np.array([len(s.recording.presses) for s in samples]),
        "SSIM of the reconstruction": np.array([f["ssim"] for f in scores]),
    }
    histograms = {name: values for name, values in histograms.items() if len(values)}
    for axes, (name, values) in zip(row, histograms.items(), strict=False):
        axes.hist(values, bins=30, color="#4477AA")
        axes.set_xlabel(name, fontsize=7)
        axes.tick_params(labelsize=6)
    for axes in row[len(histograms) :]:
        axes.remove()


def draw_matrix(
    axes: Axes,
    fractions: Float[np.ndarray, "c c"],
    names: Sequence[str],
    cells: Iterator[str],
    fontsize: int = 10,
) -> None:
    """Draw a matrix of fractions as colours with text in its cells.

    Args:
        axes: Axes to draw on.
        fractions: Values, 0 to 1, (c, c).
        names: Name of each row and column.
        cells: Text of the cells, row by row.
        fontsize: Size of the text, points.
    """
    axes.imshow(fractions, cmap="cividis", vmin=0.0, vmax=1.0)
    for (i, j), cell in zip(np.ndindex(*fractions.shape), cells, strict=True):
        colour = "black" if fractions[i, j] > 0.5 else "white"
        axes.text(j, i, cell, ha="center", va="center", color=colour, fontsize=fontsize)
    labels = [one_line(name, _MAX_NAME) for name in names]
    axes.set_xticks(range(len(labels)), labels)
    axes.set_yticks(range(len(labels)), labels)


def plot_confusion(
    confusion: Int[np.ndarray, "c c"], classes: Sequence[str], path: str | Path
) -> Path:
    """Draw a confusion matrix: colours are fractions of each true class, cells are counts.

    Args:
        confusion: Counts by true (row) and predicted (column) class, (c, c).
        classes: Names of the classes.
        path: Path of the png, pdf or svg file.

    Returns:
        The path.
    """
    figure = new_figure(1.6 + 0.8 * len(classes), 1.2 + 0.8 * len(classes))
    axes = figure.subplots()
    fractions = confusion / np.maximum(confusion.sum(axis=1, keepdims=True), 1)
    draw_matrix(axes, fractions, classes, (str(count) for count in confusion.ravel()))
    axes.set(xlabel="predicted", ylabel="true")
    return save_figure(figure, path)


def plot_examples(
    maps: Float[np.ndarray, "n v v v"],
    titles: Sequence[str],
    correct: Sequence[bool],
    path: str | Path,
    *,
    shown: int = 12,
) -> Path:
    """Draw middle slices of maps with their predicted class, misclassified ones first.

    Args:
        maps: Maps on voxels, (n, v, v, v).
        titles: Title of each map.
        correct: Whether each prediction is correct.
        path: Path of the png, pdf or svg file.
        shown: Maximum number of maps.

    Returns:
        The path.
    """
    order = sorted(range(len(titles)), key=lambda i: bool(correct[i]))[:shown]
    columns = min(6, len(order))
    rows = -(-len(order) // columns)
    figure = new_figure(1.7 * columns, 2.0 * rows)
    grid = figure.subplots(rows, columns, squeeze=False)
    for axes, i in zip(grid.ravel(), order, strict=False):
        axes.imshow(maps[i][:, maps.shape[2] // 2].T, origin="lower", cmap="viridis")
        title = one_line(titles[i], 2 * _MAX_NAME)
        axes.set_title(title, fontsize=7, color="black" if correct[i] else VERMILION)
        axes.set(xticks=[], yticks=[])
    for axes in grid.ravel()[len(order) :]:
        axes.remove()
    return save_figure(figure, path)


def plot_predictions(
    truth: Float[np.ndarray, "n v v v"],
    image: Float[np.ndarray, "n v v v"],
    mean: Float[np.ndarray, "n v v v"],
    deviation: Float[np.ndarray, "n v v v"],
    inside: Bool[np.ndarray, "n v v v"],
    correlations: Sequence[float],
    path: str | Path,
    *,
    shown: int = 8,
) -> Path:
    """Draw slices of the logarithm of E relative to the uniform fit, for some objects.

    Objects are selected evenly from the best to the worst; each slice, across y, is the one with
    the largest variance of the truth.

    Args:
        truth: True values, (n, v, v, v).
        image: Linear reconstruction, (n, v, v, v).
        mean: Mean of the prediction, (n, v, v, v).
        deviation: Standard deviation of the prediction, (n, v, v, v).
        inside: Voxels within the body, (n, v, v, v).
        correlations: Correlation of prediction and truth, (n,).
        path: Path of the png, pdf or svg file.
        shown: Maximum number of objects.

    Returns:
        The path.
    """
    order = np.argsort(correlations)[::-1]
    selected = order[np.linspace(0, len(order) - 1, min(shown, len(order))).round().astype(int)]
    truth, image, mean, deviation = (
        np.where(inside, field, np.nan)[selected] for field in (truth, image, mean, deviation)
    )
    levels = [int(np.argmax(np.nan_to_num(t).var(axis=(0, 2)))) for t in truth]
    top = max(float(np.nanquantile(np.abs(truth), 0.995)), 1e-3)
    rows = {
        "truth": (truth, -top, top, "coolwarm"),
        "linear image": (image, -top, top, "coolwarm"),
        "prediction": (mean, -top, top, "coolwarm"),
        "standard deviation": (deviation, 0.0, 0.5 * top, "viridis"),
    }
    figure = new_figure(1.7 * len(selected) + 1.6, 7.0)
    grid = figure.subplots(4, len(selected), squeeze=False)
    for line, (name, (fields, low, high, cmap)) in zip(grid, rows.items(), strict=True):
        for axes, field, level in zip(line, fields, levels, strict=True):
            drawn = axes.imshow(field[:, level].T, origin="lower", cmap=cmap, vmin=low, vmax=high)
            axes.set(xticks=[], yticks=[])
        line[0].set_ylabel(f"{name}\nz")
        figure.colorbar(drawn, ax=list(line), label="log E / E uniform", shrink=0.9)
    for axes, i in zip(grid[0], selected, strict=True):
        axes.set_title(f"r = {correlations[i]:.2f}", fontsize=8)
    for axes in grid[-1]:
        axes.set_xlabel("x")
    return save_figure(figure, path)

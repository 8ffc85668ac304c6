"""Figures of datasets and of trained networks: samples, recognizer, surrogate."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float, Int
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tactorch.errors import ConfigError
from tactorch.generation import Sample
from tactorch.text import one_line
from tactorch.touch import Touch
from tactorch.viz.figure import BLUE, VERMILION, draw_diagonal, new_axes, new_grid
from tactorch.viz.slicing import cut, even_planes

_MAX_SAMPLES = 6
_PIXELS = 80
_MAX_NAME = 24
_ARROW = 8.0  # length of arrows over the motion of the markers
_CONTRAST = 2.0  # of the difference to the image without contact


def samples_figure(samples: Sequence[Sample]) -> Figure:
    """Return a figure of middle slices of some samples, and histograms of all."""
    shown = _some(samples)
    reconstructed = any(sample.reconstruction is not None for sample in shown)
    names = ("truth", "reconstruction") if reconstructed else ("truth",)
    rows = len(names) + 1
    figure, grid = new_grid(2.0 * _MAX_SAMPLES, 2.2 * rows, rows, _MAX_SAMPLES)
    for column, sample in enumerate(shown):
        mesh = sample.recording.mesh
        (middle,) = cut(mesh, even_planes(mesh, 1), _PIXELS)
        maps = (sample.truth, sample.reconstruction)
        for axes, values in zip(grid[: len(names), column], maps, strict=False):
            if values is not None:
                middle.draw(axes, values, vmin=0.0, vmax=float(sample.truth.max()))
                axes.set(xticks=[], yticks=[])
        label = one_line(sample.label, _MAX_NAME)
        grid[0, column].set_title(f"{sample.index}: {label}", fontsize=8)
    for row, name in enumerate(names):
        grid[row, 0].set_ylabel(name)
    histograms = _histograms(samples)
    for axes, (name, values) in zip(grid[-1], histograms.items(), strict=False):
        axes.hist(values, bins=30, color="#4477AA")
        axes.set_xlabel(name, fontsize=7)
        axes.tick_params(labelsize=6)
    for axes in (*grid[:-1, len(shown) :].ravel(), *grid[-1, len(histograms) :]):
        axes.remove()
    return figure


def _some(samples: Sequence[Sample]) -> Sequence[Sample]:
    return samples[:: max(1, len(samples) // _MAX_SAMPLES)][:_MAX_SAMPLES]


def _histograms(samples: Sequence[Sample]) -> dict[str, np.ndarray]:
    histograms = {
        "Young's modulus, log10 MPa": np.log10(np.concatenate([s.truth for s in samples])),
        "largest displacement, mm": np.array([s.largest_mm for s in samples]),
        "presses": np.array([len(s.recording.presses) for s in samples]),
        "SSIM of the reconstruction": np.array([s.figures["ssim"] for s in samples if s.figures]),
    }
    return {name: values for name, values in histograms.items() if len(values)}


def touch_figure(samples: Sequence[Sample]) -> Figure:
    """Return a figure of the last press of some samples that have a touch.

    Rows are the image with the motion of the markers (8 times as long), the difference to the
    image without contact, and the height of the gel's face. Titles have the force on the gel.

    Raises:
        ConfigError: No sample has a touch.
    """
    with_touch = [sample for sample in samples if sample.touch is not None]
    if not with_touch:
        raise ConfigError("no sample has images of a sensor; generate dataset=touch.")
    shown = _some(with_touch)
    has_heights = all(sample.touch.height_mm is not None for sample in shown)  # type: ignore[union-attr]
    names = ("image, markers x 8", "difference x 2", "height")[: 3 if has_heights else 2]
    rows = len(names)
    figure, grid = new_grid(2.3 * len(shown) + 0.8, 1.75 * rows, rows, len(shown))
    for column, sample in zip(grid.T, shown, strict=True):
        assert sample.touch is not None
        _draw(column, sample.touch)
        force = -float(sample.touch.total_force[-1, 2])
        body = one_line(str(sample.facts.get("body", sample.label)), _MAX_NAME)
        column[0].set_title(f"{sample.index}: {body}, {force:.2f} N", fontsize=8)
    for axes, name in zip(grid[:, 0], names, strict=True):
        axes.set_ylabel(name, fontsize=8)
    return figure


def _draw(column: np.ndarray, touch: Touch) -> None:
    image = touch.images[-1]
    column[0].imshow(image)
    rest = touch.rest_markers_px
    if len(rest):
        moved = _ARROW * (touch.markers_px[-1] - rest)
        column[0].quiver(
            *rest.T, *moved.T, angles="xy", scale_units="xy", scale=1.0, color="white", width=0.008
        )
    change = image.astype(float) - touch.reference
    column[1].imshow(np.clip(127.0 + _CONTRAST * change, 0, 255).astype(np.uint8))
    if touch.height_mm is not None and len(column) > 2:
        _with_scale(column[2], touch.height_mm[-1], "mm")
    for axes in column:
        axes.set(xticks=[], yticks=[])


def _with_scale(axes: Axes, values: np.ndarray, unit: str) -> None:
    drawn = axes.imshow(values, cmap="viridis")
    bar = axes.figure.colorbar(drawn, ax=axes, shrink=0.8)
    bar.ax.tick_params(labelsize=6)
    bar.set_label(unit, fontsize=6)


def draw_matrix(
    axes: Axes,
    fractions: Float[np.ndarray, "c c"],
    names: Sequence[str],
    cells: Iterator[str],
    fontsize: int = 10,
) -> None:
    """Draw a matrix of values from 0 to 1 as colours with the text of its cells, row by row."""
    axes.imshow(fractions, cmap="cividis", vmin=0.0, vmax=1.0)
    for (i, j), cell in zip(np.ndindex(*fractions.shape), cells, strict=True):
        colour = "black" if fractions[i, j] > 0.5 else "white"
        axes.text(j, i, cell, ha="center", va="center", color=colour, fontsize=fontsize)
    labels = [one_line(name, _MAX_NAME) for name in names]
    axes.set_xticks(range(len(labels)), labels)
    axes.set_yticks(range(len(labels)), labels)


def confusion_figure(confusion: Int[np.ndarray, "c c"], classes: Sequence[str]) -> Figure:
    """Return a figure of counts by true (row) and predicted (column) class.

    Colours are fractions of each true class.
    """
    figure, axes = new_axes(1.6 + 0.8 * len(classes), 1.2 + 0.8 * len(classes))
    fractions = confusion / np.maximum(confusion.sum(axis=1, keepdims=True), 1)
    draw_matrix(axes, fractions, classes, (str(count) for count in confusion.ravel()))
    axes.set(xlabel="predicted", ylabel="true")
    return figure


def reliability_figure(
    confidence: Float[np.ndarray, " b"],
    accuracy: Float[np.ndarray, " b"],
    counts: Int[np.ndarray, " b"],
) -> Figure:
    """Return a figure of the accuracy of a classifier by confidence; empty bins are omitted."""
    figure, axes = new_axes(4.2, 4.0)
    draw_diagonal(axes)
    filled = counts > 0
    axes.plot(confidence[filled], accuracy[filled], "o-", color=BLUE, label="measured")
    for x, y, count in zip(confidence[filled], accuracy[filled], counts[filled], strict=True):
        axes.annotate(str(count), (x, y), textcoords="offset points", xytext=(4, -10), fontsize=7)
    axes.set(xlabel="predicted probability", ylabel="accuracy", ylim=(0, 1.02))
    axes.legend()
    return figure


def coverage_figure(levels: Sequence[float], covered: Sequence[float]) -> Figure:
    """Return a figure of the fraction of voxels in predictive intervals by level, 0 to 1."""
    figure, axes = new_axes(4.2, 4.0)
    draw_diagonal(axes)
    axes.plot(levels, covered, "o-", color=BLUE, label="measured")
    axes.set(xlabel="level of the intervals", ylabel="fraction of voxels covered")
    axes.legend()
    return figure


def examples_figure(
    maps: Float[np.ndarray, "n v v v"], titles: Sequence[str], correct: Sequence[bool]
) -> Figure:
    """Return a figure of middle slices of 12 maps, misclassified ones first."""
    order = sorted(range(len(titles)), key=lambda i: bool(correct[i]))[:12]
    columns = min(6, len(order))
    rows = -(-len(order) // columns)
    figure, grid = new_grid(1.7 * columns, 2.0 * rows, rows, columns)
    for axes, i in zip(grid.ravel(), order, strict=False):
        axes.imshow(maps[i][:, maps.shape[2] // 2].T, origin="lower", cmap="viridis")
        title = one_line(titles[i], 2 * _MAX_NAME)
        axes.set_title(title, fontsize=7, color="black" if correct[i] else VERMILION)
        axes.set(xticks=[], yticks=[])
    for axes in grid.ravel()[len(order) :]:
        axes.remove()
    return figure


def predictions_figure(
    fields: Mapping[str, Float[np.ndarray, "n v v v"]],
    inside: Bool[np.ndarray, "n v v v"],
    correlations: Sequence[float],
) -> Figure:
    """Return a figure of the logarithm of E relative to the uniform fit, for 8 objects.

    Objects are selected evenly from the best to the worst; each slice, across y, is the one with
    the largest variance of the truth. `fields` are "truth", "image", "mean" and "deviation".
    """
    order = np.argsort(correlations)[::-1]
    selected = order[np.linspace(0, len(order) - 1, min(8, len(order))).round().astype(int)]
    shown = {name: np.where(inside, field, np.nan)[selected] for name, field in fields.items()}
    levels = [int(np.argmax(np.nan_to_num(t).var(axis=(0, 2)))) for t in shown["truth"]]
    top = max(float(np.nanquantile(np.abs(shown["truth"]), 0.995)), 1e-3)
    rows = {
        "truth": ("truth", -top, top, "coolwarm"),
        "linear image": ("image", -top, top, "coolwarm"),
        "prediction": ("mean", -top, top, "coolwarm"),
        "standard deviation": ("deviation", 0.0, 0.5 * top, "viridis"),
    }
    figure, grid = new_grid(1.7 * len(selected) + 1.6, 7.0, len(rows), len(selected))
    for line, (label, (name, low, high, cmap)) in zip(grid, rows.items(), strict=True):
        for axes, field, level in zip(line, shown[name], levels, strict=True):
            drawn = axes.imshow(field[:, level].T, origin="lower", cmap=cmap, vmin=low, vmax=high)
            axes.set(xticks=[], yticks=[])
        line[0].set_ylabel(f"{label}\nz")
        figure.colorbar(drawn, ax=list(line), label="log E / E uniform", shrink=0.9)
    for axes, i in zip(grid[0], selected, strict=True):
        axes.set_title(f"r = {correlations[i]:.2f}", fontsize=8)
    for axes in grid[-1]:
        axes.set_xlabel("x")
    return figure

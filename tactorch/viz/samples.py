"""What is in a dataset, in one picture."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from tactorch.errors import ConfigError
from tactorch.generation import Sample
from tactorch.viz._figure import new_figure, save_figure
from tactorch.viz.sampling import slice_body

_SHOWN = 6
_PIXELS = 80


def plot_samples(samples: Sequence[Sample], path: str | Path) -> Path:
    """Draw middle slices of some samples, and how moduli and signals are spread over all.

    Args:
        samples: At least one.
        path: Of the picture (png, pdf or svg).

    Raises:
        ConfigError: There is no sample, or the suffix is none of a picture's.
    """
    if not samples:
        raise ConfigError("there is no sample to draw; generate some first.")
    shown = samples[:: max(1, len(samples) // _SHOWN)][:_SHOWN]
    found = any(sample.reconstruction is not None for sample in shown)
    names = ("truth", "found") if found else ("truth",)
    figure = new_figure(2.0 * _SHOWN, 2.2 * (len(names) + 1))
    grid = figure.subplots(len(names) + 1, _SHOWN, squeeze=False)
    for column, sample in enumerate(shown):
        maps = (sample.truth, sample.reconstruction)
        for axes, values in zip(grid[: len(names), column], maps, strict=False):
            if values is not None:
                _draw_slice(axes, sample, values, float(sample.truth.max()))
        grid[0, column].set_title(f"{sample.index}: {sample.label}", fontsize=8)
    for row, name in enumerate(names):
        grid[row, 0].set_ylabel(name)
    for axes in grid[:-1, len(shown) :].ravel():
        axes.remove()
    _draw_histograms(grid[-1], samples)
    return save_figure(figure, path)


def _draw_slice(axes: Axes, sample: Sample, values: np.ndarray, top: float) -> None:
    """The middle slice across y."""
    (middle,) = slice_body(sample.recording.mesh, 1, _PIXELS)[1]
    painted = middle.values(values)
    axes.imshow(painted, extent=middle.extent_mm, origin="lower", vmin=0.0, vmax=top)
    axes.set(xticks=[], yticks=[])


def _draw_histograms(row: np.ndarray, samples: Sequence[Sample]) -> None:
    figures = [sample.figures for sample in samples if sample.figures]
    wanted = {
        "Young's modulus, log10 MPa": np.log10(np.concatenate([s.truth for s in samples])),
        "largest displacement, mm": np.array([s.largest_mm for s in samples]),
        "presses": np.array([len(s.recording.presses) for s in samples]),
        "SSIM of the reconstruction": np.array([f["ssim"] for f in figures]),
    }
    kept = {name: values for name, values in wanted.items() if len(values)}
    for axes, (name, values) in zip(row, kept.items(), strict=False):
        axes.hist(values, bins=30, color="#4477AA")
        axes.set_xlabel(name, fontsize=7)
        axes.tick_params(labelsize=6)
    for axes in row[len(kept) :]:
        axes.remove()

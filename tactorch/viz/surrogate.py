"""What a surrogate foretells, beside the truth, and how far it may be believed."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes

from tactorch.viz._figure import new_figure, save_figure


def plot_coverage(levels: Sequence[float], covered: Sequence[float], path: str | Path) -> Path:
    """Draw the share of the truth within intervals against what they state."""
    figure = new_figure(4.2, 4.0)
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], "--", color="grey", label="as stated")
    axes.plot(levels, covered, "o-", color="#0072B2", label="measured")
    axes.set(xlabel="stated probability", ylabel="share of voxels within", xlim=(0, 1), ylim=(0, 1))
    axes.legend()
    return save_figure(figure, path)


def plot_foretold(
    truth: Float[np.ndarray, "n v v v"],
    image: Float[np.ndarray, "n v v v"],
    mean: Float[np.ndarray, "n v v v"],
    deviation: Float[np.ndarray, "n v v v"],
    correlations: Sequence[float],
    path: str | Path,
    *,
    shown: int = 8,
) -> Path:
    """Draw slices of log E over the uniform modulus: truth, linear image, foretold, deviation.

    Objects are evenly picked from the best to the worst; the slice is the one where the truth
    varies most.
    """
    order = np.argsort(correlations)[::-1]
    picked = order[np.linspace(0, len(order) - 1, min(shown, len(order))).round().astype(int)]
    figure = new_figure(1.7 * len(picked) + 0.6, 7.0)
    grid = figure.subplots(4, len(picked), squeeze=False)
    for column, i in zip(grid.T, picked, strict=True):
        level = int(np.argmax(truth[i].var(axis=(0, 2))))
        top = max(float(np.abs(truth[i]).max()), 1e-3)
        for axes, field in zip(column, (truth[i], image[i], mean[i]), strict=False):
            _draw(axes, field[:, level], -top, top, "coolwarm")
        _draw(column[3], deviation[i][:, level], 0.0, top, "viridis")
        column[0].set_title(f"r = {correlations[i]:.2f}", fontsize=8)
    for axes, name in zip(
        grid[:, 0], ("truth", "linear image", "foretold", "deviation"), strict=True
    ):
        axes.set_ylabel(name)
    return save_figure(figure, path)


def _draw(axes: Axes, values: Float[np.ndarray, "v w"], low: float, high: float, map_: str) -> None:
    axes.imshow(values.T, origin="lower", cmap=map_, vmin=low, vmax=high)
    axes.set(xticks=[], yticks=[])

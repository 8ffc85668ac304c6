"""What a surrogate foretells, beside the truth, and how far it may be believed."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

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
    inside: Bool[np.ndarray, "n v v v"],
    correlations: Sequence[float],
    path: str | Path,
    *,
    shown: int = 8,
) -> Path:
    """Draw slices of log E over the uniform modulus: truth, linear image, foretold, deviation.

    Objects are evenly picked from the best to the worst; each slice, across y, is the one where
    the truth varies most.
    """
    order = np.argsort(correlations)[::-1]
    picked = order[np.linspace(0, len(order) - 1, min(shown, len(order))).round().astype(int)]
    truth, image, mean, deviation = (
        np.where(inside, field, np.nan)[picked] for field in (truth, image, mean, deviation)
    )
    levels = [int(np.argmax(np.nan_to_num(t).var(axis=(0, 2)))) for t in truth]
    top = max(float(np.nanquantile(np.abs(truth), 0.995)), 1e-3)
    rows = {
        "truth": (truth, -top, top, "coolwarm"),
        "linear image": (image, -top, top, "coolwarm"),
        "foretold": (mean, -top, top, "coolwarm"),
        "deviation": (deviation, 0.0, 0.5 * top, "viridis"),
    }
    figure = new_figure(1.7 * len(picked) + 1.6, 7.0)
    grid = figure.subplots(4, len(picked), squeeze=False)
    for line, (name, (fields, low, high, colours)) in zip(grid, rows.items(), strict=True):
        for axes, field, level in zip(line, fields, levels, strict=True):
            drawn = axes.imshow(
                field[:, level].T, origin="lower", cmap=colours, vmin=low, vmax=high
            )
            axes.set(xticks=[], yticks=[])
        line[0].set_ylabel(f"{name}\nz")
        figure.colorbar(drawn, ax=list(line), label="log E / E uniform", shrink=0.9)
    for axes, i in zip(grid[0], picked, strict=True):
        axes.set_title(f"r = {correlations[i]:.2f}", fontsize=8)
    for axes in grid[-1]:
        axes.set_xlabel("x")
    return save_figure(figure, path)

"""What was measured, over the frames."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from tactorch.viz._figure import new_figure, save_figure

_COLOURS = ("#0072B2", "#D55E00", "#009E73")


def plot_over_time(
    panels: Mapping[str, Mapping[str, Float[np.ndarray, " f"]]],
    time_s: Float[np.ndarray, " f"] | None,
    faulty: Sequence[int],
    path: str | Path,
) -> Path:
    """Draw measures over time, or over frames where times are unknown.

    Args:
        panels: For each label of a vertical axis, the lines by their names; NaN is left out.
        time_s: Of the frames.
        faulty: Frames that are marked.
        path: Of the picture.
    """
    count = len(next(iter(next(iter(panels.values())).values())))
    across = np.arange(count, dtype=float) if time_s is None else time_s
    figure = new_figure(8.0, 0.8 + 2.1 * len(panels))
    for axes, (label, lines) in zip(
        figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0],
        panels.items(),
        strict=True,
    ):
        for colour, (name, values) in zip(_COLOURS, lines.items(), strict=False):
            mark = "." if count <= 60 else None
            axes.plot(across, values, color=colour, label=name, marker=mark, lw=1.4)
        for number, k in enumerate(faulty):
            told = "faulty frame" if number == 0 else None
            axes.axvline(across[k], color="0.6", lw=0.8, ls=":", label=told, zorder=0)
        axes.set_ylabel(label)
        axes.grid(alpha=0.3)
        if len(lines) > 1 or len(faulty):
            axes.legend(fontsize=8)
    axes.set_xlabel("frame" if time_s is None else "time, s")
    return save_figure(figure, path)

"""Figures of a sensor session: measurements and contacts over time."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tactorch.recording import Recording
from tactorch.sensor.chain import Measurement
from tactorch.sensor.recorder import ContactInterval
from tactorch.viz.figure import BLUE, COLOURS, GREEN, VERMILION, new_grid

_LEGEND = {"fontsize": 8, "loc": "lower center", "bbox_to_anchor": (0.5, 1.0)}


def over_time_figure(
    panels: Mapping[str, Mapping[str, Float[np.ndarray, " f"]]],
    time_s: Float[np.ndarray, " f"] | None,
    faulty: Sequence[int],
) -> Figure:
    """Return a figure of measurements over time, or over frame numbers if times are unknown.

    `panels` are the values of each line by the label of the vertical axis and the name of the line;
    `faulty` are the indices of frames that are marked.
    """
    count = len(next(iter(next(iter(panels.values())).values())))
    across = np.arange(count, dtype=float) if time_s is None else time_s
    figure, grid = new_grid(8.0, 0.8 + 2.1 * len(panels), len(panels), 1, sharex=True)
    marker = "." if count <= 60 else None
    for axes, (label, lines) in zip(grid[:, 0], panels.items(), strict=True):
        for colour, (name, values) in zip(COLOURS, lines.items(), strict=False):
            axes.plot(across, values, color=colour, label=name, marker=marker, lw=1.4)
        _mark_faulty(axes, across[list(faulty)])
        axes.set_ylabel(label)
        axes.grid(alpha=0.3)
        if len(lines) > 1 or len(faulty):
            axes.legend(fontsize=8)
    axes.set_xlabel("frame" if time_s is None else "time, s")
    return figure


def _mark_faulty(axes: Axes, positions: Float[np.ndarray, " k"]) -> None:
    for number, x in enumerate(positions):
        label = "faulty frame" if number == 0 else None
        axes.axvline(x, color="0.6", lw=0.8, ls=":", label=label, zorder=0)


def session_figure(
    recording: Recording, measurements: Sequence[Measurement], contacts: Sequence[ContactInterval]
) -> Figure:
    """Return a figure of the depth over time with contacts, and of the forces of the presses.

    The arguments are the results of `tactorch.sensor.recorder.record`.
    """
    frames, rows = [m.frame for m in measurements], recording.provenance["presses"]
    times = [frame.time_s for frame in frames]
    timed = all(time is not None for time in times)
    across = np.array(times if timed else range(len(frames)), dtype=float)
    position = {frame.name: across[i] for i, frame in enumerate(frames)}
    presses = [position[row["frame"]] for row in rows]
    figure, grid = new_grid(8.0, 5.0, 2, 1, sharex=True)
    upper, lower = grid[:, 0]
    depths = [measurement.depth_mm for measurement in measurements]
    upper.plot(across, depths, color=BLUE, marker=".", lw=1.4, label="depth")
    upper.plot(
        presses, [row["depth_mm"] for row in rows], ls="none", marker="o", mfc="none",
        mew=1.6, ms=9, color=VERMILION, label="recorded press",
    )  # fmt: skip
    _mark_faulty(upper, across[[i for i, frame in enumerate(frames) if frame.fault]])
    upper.set_ylabel("depth of the gel, mm")
    upper.legend(ncol=3, **_LEGEND)
    forces = np.array([row["force_n"] for row in rows])
    directions = np.array([press.direction for press in recording.presses])
    normal = (forces * directions).sum(axis=1)
    tangential = np.linalg.norm(forces - normal[:, None] * directions, axis=1)
    lower.plot(presses, normal, ls="none", marker="o", color=BLUE, label="along the press")
    lower.plot(presses, tangential, ls="none", marker="s", color=GREEN, label="across the press")
    lower.set_ylabel("force on the object, N")
    lower.legend(ncol=2, **_LEGEND)
    for axes in (upper, lower):
        axes.grid(alpha=0.3)
        axes.margins(y=0.15)
        for contact in contacts:
            ends = (position[contact.measurements[i].frame.name] for i in (0, -1))
            axes.axvspan(*ends, color="0.88", zorder=-1)
    lower.set_xlabel("time, s" if timed else "frame")
    return figure

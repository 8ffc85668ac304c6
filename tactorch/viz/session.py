"""A session of a sensor over time: how deep it pressed, its contacts, and what was kept."""

from pathlib import Path

import numpy as np

from tactorch.sensor.recorder import Recorded
from tactorch.viz._figure import new_figure, save_figure

_DEPTH, _KEPT, _CONTACT = "#0072B2", "#D55E00", "0.88"
_FORCES = (("along the press", "o", "#0072B2"), ("across it", "s", "#009E73"))


def plot_session(found: Recorded, path: str | Path) -> Path:
    """Draw depth over time with the contacts and the frames kept, and the forces of the presses.

    Args:
        found: A recorded session.
        path: Of the picture.
    """
    glances = found.session.glances
    times = [one.time_s for one in glances]
    known = all(time is not None for time in times)
    across = np.array(times if known else range(len(glances)), dtype=float)
    place = {one.name: across[i] for i, one in enumerate(glances)}
    figure = new_figure(8.0, 5.0)
    upper, lower = figure.subplots(2, 1, sharex=True)
    depths = np.array([one.depth_mm for one in glances])
    upper.plot(across, depths, color=_DEPTH, marker=".", lw=1.4, label="depth")
    kept = [row["frame"] for row in found.presses]
    upper.plot(
        [place[name] for name in kept], [row["depth_mm"] for row in found.presses],
        ls="none", marker="o", mfc="none", mew=1.6, ms=9, color=_KEPT, label="kept as a press",
    )  # fmt: skip
    faulty = [i for i, one in enumerate(glances) if one.fault]
    for number, i in enumerate(faulty):
        label = "faulty frame" if number == 0 else None
        upper.axvline(across[i], color="0.5", ls=":", lw=0.9, label=label, zorder=0)
    upper.set_ylabel("depth of the gel, mm")
    upper.legend(fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncol=3)
    forces = np.array([row["force_n"] for row in found.presses])
    pushes = np.array([press.direction for press in found.recording.presses])
    along = (forces * pushes).sum(axis=1)
    parts = (along, np.linalg.norm(forces - along[:, None] * pushes, axis=1))
    for (label, mark, colour), values in zip(_FORCES, parts, strict=True):
        lower.plot(
            [place[name] for name in kept], values, ls="none", marker=mark, color=colour,
            label=label,
        )  # fmt: skip
    lower.set_ylabel("force on the object, N")
    lower.legend(fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncol=2)
    for axes in (upper, lower):
        axes.grid(alpha=0.3)
        axes.margins(y=0.15)
        for number in range(len(found.session.contacts)):
            own = [i for i, one in enumerate(glances) if one.contact == number]
            axes.axvspan(across[own[0]], across[own[-1]], color=_CONTACT, zorder=-1)
    lower.set_xlabel("time, s" if known else "frame")
    return save_figure(figure, path)

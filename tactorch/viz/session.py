"""Figures of a sensor session: measurements over time, contacts, and the recorded presses."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.spatial import cKDTree

from tactorch.errors import ConfigError
from tactorch.recording import Press, Recording
from tactorch.sensor.chain import Measurement
from tactorch.sensor.recorder import ContactInterval
from tactorch.text import one_line
from tactorch.viz.figure import BLUE, COLOURS, GREEN, VERMILION, new_grid
from tactorch.viz.views import axis_name, plane_across, push_direction

_MAX_PRESSES = 6
_WIDTH, _HEIGHT = 2.8, 6.4  # inches per press
_MAX_NAME = 30
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


def presses_figure(recording: Recording, max_presses: int = _MAX_PRESSES) -> Figure:
    """Return a figure of displacement and force of presses, each seen along the press.

    Colours show the components along the press, arrows those across it. A press without direction
    is seen along its total force. The last step of each contact is drawn first.
    """
    if max_presses < 1:
        raise ConfigError(f"max_presses={max_presses} must be at least 1.")
    presses = _select(recording, max_presses)
    figure, grid = new_grid(_WIDTH * len(presses) + 0.8, _HEIGHT, 2, len(presses))
    displacements = [_displacement(press, recording.mesh.points) for press in presses]
    observed = [np.isfinite(displacement) for displacement in displacements]
    forces = [p.forces for p in presses]
    rows = (
        (displacements, observed, "displacement along the press, mm", "mm"),
        (forces, forces, "force along the press, N", "N"),
    )
    for axes_row, (values, masks, label, unit) in zip(grid, rows, strict=True):
        along = [
            value @ push_direction(press) for value, press in zip(values, presses, strict=True)
        ]
        top = max(float(np.nanmax(np.abs(part))) for part in along) or 1.0
        for axes, press, value, mask, colours in zip(
            axes_row, presses, values, masks, along, strict=True
        ):
            shown = np.any(mask, axis=1)
            across = plane_across(push_direction(press))
            flat = recording.mesh.points @ across.T
            dots = axes.scatter(
                *flat[shown].T, c=colours[shown], cmap="cividis", vmin=min(0.0, -0.1 * top),
                vmax=top, s=26, edgecolor="0.25", linewidth=0.3,
            )  # fmt: skip
            _draw_arrows(axes, flat, np.nan_to_num(value @ across.T), shown, unit)
            axes.set_xlabel(f"{axis_name(across[0])}, mm", fontsize=8)
            axes.set_ylabel(f"{axis_name(across[1])}, mm", fontsize=8)
            axes.tick_params(labelsize=7)
        figure.colorbar(dots, ax=axes_row, label=label, shrink=0.9, pad=0.02)
    for number, (axes, press) in enumerate(zip(grid[0], presses, strict=True), start=1):
        axes.set_title(one_line(press.name, _MAX_NAME) or f"press {number}", fontsize=9)
    return figure


def _displacement(press: Press, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Measured displacement of each node, NaN where unknown; along an axis at the nodes nearest."""
    displacement = np.where(press.observed, press.displacement, np.nan)
    if press.surface is not None and not press.observed.any():
        _, nearest = cKDTree(points).query(press.surface.points_mm)
        along = press.surface.displacement_mm[:, None]
        displacement[nearest] = along * press.surface.directions
    return displacement


def _draw_arrows(
    axes: Axes, flat: np.ndarray, vectors: np.ndarray, shown: np.ndarray, unit: str
) -> None:
    """Draw in-plane vectors of the nodes shown, and the extent of the object."""
    arrows = vectors[shown]
    longest = max(float(np.linalg.norm(arrows, axis=1).max(initial=0.0)), 1e-12)
    low, high = flat.min(axis=0), flat.max(axis=0)
    scale = longest / (0.12 * float((high - low).max()))
    axes.quiver(
        *flat[shown].T, *arrows.T, angles="xy", scale_units="xy", scale=scale, color=VERMILION,
        width=0.006,
    )  # fmt: skip
    low, high = low - 0.06 * (high - low), high + 0.06 * (high - low)
    axes.set(aspect="equal", xlim=(low[0], high[0]), ylim=(low[1], high[1]), facecolor="0.94")
    text = f"longest arrow {longest:.2g} {unit}"
    axes.text(0.02, 0.02, text, transform=axes.transAxes, fontsize=7)


def _select(recording: Recording, count: int) -> list[Press]:
    """Return up to `count` presses of the highest steps, in their order."""
    order = sorted(range(len(recording.presses)), key=lambda i: -recording.presses[i].step)
    return [recording.presses[i] for i in sorted(order[:count])]

"""Figure of presses by a rigid probe: the measured force over the surface."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from tactorch.recording import Press, Recording
from tactorch.viz.figure import new_axes
from tactorch.viz.views import axis_name, plane_across, push_direction

_ROUNDING_MM = 1e-3  # presses at the same place


class _Place(NamedTuple):
    """The deepest press at a place."""

    position_mm: Float[np.ndarray, "2"]
    depth_mm: float
    force_n: float


def palpation_figure(recording: Recording) -> Figure:
    """Return a figure of the force of the deepest press at each place, seen along the push.

    Presses without a measured force are shown as rings.

    Args:
        recording: Presses, some by a probe; others are not shown.
    """
    presses = [press for press in recording.presses if press.probe is not None]
    across = plane_across(push_direction(presses[0]))
    places = _places(presses, across)
    positions = np.array([place.position_mm for place in places])
    forces = np.array([place.force_n for place in places])
    figure, axes = new_axes(6.0, 5.0)
    known = np.isfinite(forces)
    x, y = positions.T
    axes.plot(x[~known], y[~known], "o", color="none", markeredgecolor="0.4", markersize=5)
    if known.any():
        dots = axes.scatter(x[known], y[known], c=forces[known], cmap="cividis", s=24)
        figure.colorbar(dots, ax=axes, label="force of the deepest press (N)")
    axes.set(xlabel=f"{axis_name(across[0])} (mm)", ylabel=f"{axis_name(across[1])} (mm)")
    axes.set_aspect("equal")
    axes.set_title(f"{len(places)} places, {len(presses)} presses", fontsize=9)
    return figure


def _places(presses: list[Press], across: Float[np.ndarray, "2 3"]) -> list[_Place]:
    """Return the deepest press of each place."""
    deepest: dict[tuple[int, ...], _Place] = {}
    for press in presses:
        pose = press.probe
        assert pose is not None
        position = across @ pose.position_mm
        depth = float(push_direction(press) @ pose.position_mm)
        force = float(np.abs(press.force.values).max()) if press.force is not None else np.nan
        key = tuple(np.round(position / _ROUNDING_MM).astype(int).tolist())
        if key not in deepest or deepest[key].depth_mm < depth:
            deepest[key] = _Place(position, depth, force)
    return list(deepest.values())

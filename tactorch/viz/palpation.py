"""Figure of presses by a rigid probe: the measured force over the surface."""

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from tactorch.recording import Press, Recording
from tactorch.viz.figure import new_axes
from tactorch.viz.views import axis_name, plane_across, push_direction

_ROUNDING_MM = 1e-3  # presses at the same place


def palpation_figure(recording: Recording) -> Figure:
    """Return a figure of the force of the deepest press at each place, seen along the push.

    Presses without a measured force are shown as rings.

    Args:
        recording: Presses, some by a probe; others are not shown.
    """
    presses = [press for press in recording.presses if press.probe is not None]
    across = plane_across(push_direction(presses[0]))
    deepest = _deepest(presses, across)
    forces = np.array([_force(press) for press in deepest])
    figure, axes = new_axes(6.0, 5.0)
    known = np.isfinite(forces)
    x, y = across @ np.array([_tip(press) for press in deepest]).T
    axes.plot(x[~known], y[~known], "o", color="none", markeredgecolor="0.4", markersize=5)
    if known.any():
        dots = axes.scatter(x[known], y[known], c=forces[known], cmap="cividis", s=24)
        figure.colorbar(dots, ax=axes, label="force of the deepest press (N)")
    axes.set(xlabel=f"{axis_name(across[0])} (mm)", ylabel=f"{axis_name(across[1])} (mm)")
    axes.set_aspect("equal")
    axes.set_title(f"{len(deepest)} places, {len(presses)} presses", fontsize=9)
    return figure


def _deepest(presses: list[Press], across: Float[np.ndarray, "2 3"]) -> list[Press]:
    """Return the deepest press of each place."""
    by_depth = sorted(presses, key=lambda press: float(push_direction(press) @ _tip(press)))
    places = [np.round(across @ _tip(press) / _ROUNDING_MM).astype(int) for press in by_depth]
    return list({tuple(p): press for p, press in zip(places, by_depth, strict=True)}.values())


def _tip(press: Press) -> Float[np.ndarray, "3"]:
    assert press.probe is not None
    return press.probe.position_mm


def _force(press: Press) -> float:
    return float(np.abs(press.force.values).max()) if press.force is not None else np.nan

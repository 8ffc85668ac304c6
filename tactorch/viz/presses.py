"""Figures of presses: displacement and force of each, and the force by a probe over the surface."""

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.spatial import cKDTree

from tactorch.errors import ConfigError
from tactorch.recording import Press, Recording
from tactorch.text import one_line
from tactorch.viz.figure import VERMILION, new_axes, new_grid
from tactorch.viz.slicing import AXES

_MAX_PRESSES = 6
_WIDTH, _HEIGHT = 2.8, 6.4  # inches per press
_MAX_NAME = 30
_ROUNDING_MM = 1e-3  # presses at the same place


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


def palpation_figure(recording: Recording) -> Figure:
    """Return a figure of the force of the deepest press at each place, seen along the push.

    Presses without a measured force are shown as rings.

    Args:
        recording: Presses, some by a probe; others are not shown.
    """
    presses = [press for press in recording.presses if press.probe is not None]
    across = plane_across(push_direction(presses[0]))
    deepest = _deepest(presses, across)
    measured = [press.force for press in deepest]
    forces = np.array([np.nan if f is None else np.abs(f.values).max() for f in measured])
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
    by_depth = sorted(presses, key=lambda press: float(push_direction(press) @ _tip(press)))
    places = [np.round(across @ _tip(press) / _ROUNDING_MM).astype(int) for press in by_depth]
    return list({tuple(p): press for p, press in zip(places, by_depth, strict=True)}.values())


def _tip(press: Press) -> Float[np.ndarray, "3"]:
    assert press.probe is not None
    return press.probe.position_mm


def push_direction(press: Press) -> Float[np.ndarray, "3"]:
    """Return the unit vector of a push: as stated, of the probe, or of the total force."""
    if press.direction is not None:
        return press.direction
    if press.probe is not None:
        return -press.probe.rotation[:, 2]
    size = float(np.linalg.norm(press.total_force))
    return press.total_force / size if size > 0 else np.array([0.0, 0.0, -1.0])


def plane_across(direction: Float[np.ndarray, "3"]) -> Float[np.ndarray, "2 3"]:
    """Return two unit vectors normal to a direction, close to axes of the object."""
    main = int(np.argmax(np.abs(direction)))
    first = np.eye(3)[(main + 1) % 3]
    first = first - (first @ direction) * direction
    first /= np.linalg.norm(first)
    second = np.cross(direction, first)
    second *= np.sign(second[(main + 2) % 3]) or 1.0
    return np.stack([first, second])


def axis_name(vector: Float[np.ndarray, "3"]) -> str:
    """Return the name of a direction in the axes of the object."""
    main = int(np.argmax(np.abs(vector)))
    exact = abs(abs(vector[main]) - 1.0) < 1e-3
    return AXES[main] if exact else f"about {AXES[main]}"

"""What was felt in each press: displacement and force on the object, seen along the press."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.recording import Press, Recording
from tactorch.viz._figure import new_figure, save_figure

_MOST = 6  # presses in a picture
_WIDTH, _HEIGHT = 2.8, 6.4  # inches, of a press
_EDGE = "0.25"


def plot_presses(recording: Recording, path: str | Path, most: int = _MOST) -> Path:
    """Draw presses side by side: how far nodes moved along the push, and what force they bear.

    Arrows show motion and force across the push; the object is looked at along it.

    Args:
        recording: Of presses with a direction; others are looked at along their total force.
        path: Of the picture.
        most: Presses that are drawn, the last step of each contact first.

    Raises:
        ConfigError: Fewer than one press is asked for.
    """
    if most < 1:
        raise ConfigError(f"most={most} must be at least 1.")
    presses = _chosen(recording, most)
    figure = new_figure(_WIDTH * len(presses) + 0.8, _HEIGHT)
    grid = figure.subplots(2, len(presses), squeeze=False)
    seen = [_displacement(press) for press in presses]
    for row, values, label in (
        (0, seen, "moved along the press, mm"),
        (1, [press.forces for press in presses], "force along the press, N"),
    ):
        along = [value @ _push(press) for value, press in zip(values, presses, strict=True)]
        top = max(float(np.nanmax(np.abs(one))) for one in along) or 1.0
        for column, press in enumerate(presses):
            axes = grid[row, column]
            shown = press.observed.any(axis=1) if row == 0 else press.forces.any(axis=1)
            across = _across(_push(press))
            flat = recording.mesh.points @ across.T
            dots = axes.scatter(
                *flat[shown].T, c=along[column][shown], cmap="cividis", vmin=min(0.0, -0.1 * top),
                vmax=top, s=26, edgecolor=_EDGE, linewidth=0.3,
            )  # fmt: skip
            arrows = np.nan_to_num(values[column][shown] @ across.T)
            longest = max(float(np.linalg.norm(arrows, axis=1).max(initial=0.0)), 1e-12)
            reach = 0.12 * float(np.ptp(flat, axis=0).max())
            axes.quiver(
                *flat[shown].T, *arrows.T, angles="xy", scale_units="xy", scale=longest / reach,
                color="#D55E00", width=0.006,
            )  # fmt: skip
            low, high = flat.min(axis=0), flat.max(axis=0)
            margin = 0.06 * (high - low)
            axes.set(
                aspect="equal", xlim=(low[0] - margin[0], high[0] + margin[0]),
                ylim=(low[1] - margin[1], high[1] + margin[1]), facecolor="0.94",
            )  # fmt: skip
            axes.text(
                0.02, 0.02, f"longest arrow {longest:.2g} {'mm' if row == 0 else 'N'}",
                transform=axes.transAxes, fontsize=7,
            )  # fmt: skip
            if row == 0:
                axes.set_title(press.name or f"press {column + 1}", fontsize=9)
            names = [_axis_name(vector) for vector in across]
            axes.set_xlabel(f"{names[0]}, mm", fontsize=8)
            axes.set_ylabel(f"{names[1]}, mm", fontsize=8)
            axes.tick_params(labelsize=7)
        figure.colorbar(dots, ax=grid[row, :], label=label, shrink=0.9, pad=0.02)
    return save_figure(figure, path)


def _chosen(recording: Recording, most: int) -> list[Press]:
    """The hardest of each contact where there are too many, in their order."""
    order = sorted(range(len(recording.presses)), key=lambda i: -recording.presses[i].step)
    return [recording.presses[i] for i in sorted(order[:most])]


def _push(press: Press) -> Float[np.ndarray, "3"]:
    if press.direction is not None:
        return press.direction
    total = press.total_force
    size = float(np.linalg.norm(total))
    return total / size if size > 0 else np.array([0.0, 0.0, -1.0])


def _displacement(press: Press) -> Float[np.ndarray, "n 3"]:
    return np.where(press.observed, press.displacement, np.nan)


def _across(push: Float[np.ndarray, "3"]) -> Float[np.ndarray, "2 3"]:
    """Two axes across a push, along those of the object as far as can be."""
    main = int(np.argmax(np.abs(push)))
    first = np.eye(3)[(main + 1) % 3]
    first = first - (first @ push) * push
    first /= np.linalg.norm(first)
    second = np.cross(push, first)
    second *= np.sign(second[(main + 2) % 3]) or 1.0
    return np.stack([first, second])


def _axis_name(vector: Float[np.ndarray, "3"]) -> str:
    main = int(np.argmax(np.abs(vector)))
    exact = abs(abs(vector[main]) - 1.0) < 1e-3
    return "xyz"[main] if exact else f"about {'xyz'[main]}"

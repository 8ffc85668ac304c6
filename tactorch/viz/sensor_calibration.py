"""Presses of a ball beside what a calibration sees of them."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.image import AxesImage
from matplotlib.patches import Circle as Round
from matplotlib.patheffects import withStroke

from tactorch.sensor.calibration import Ball, Circle
from tactorch.sensor.frames import Image
from tactorch.viz._figure import new_figure, save_figure
from tactorch.viz.sensor_frame import EDGE

_MOST = 8  # presses in a picture
_INSIDE = 0.9  # of a contact's radius
_SHOWN = 1.5  # of it
_DOTS = 2000
X_COLOUR, Y_COLOUR = "#0072B2", "#D55E00"


@dataclass(frozen=True, eq=False)
class SeenPress:
    """A press and what is seen of it.

    Attributes:
        name: Of the image.
        image: The image.
        first: The contact as it was labelled or found.
        circle: The contact as it was fitted, well inside which is judged.
        known: Pixels that no marker covers.
        slopes: dz/dx and dz/dy, as the calibration tells.
        height_mm: What they integrate to.
    """

    name: str
    image: Image
    first: Circle
    circle: Circle
    known: Bool[np.ndarray, "h w"]
    slopes: Float[np.ndarray, "h w 2"]
    height_mm: Float[np.ndarray, "h w"]


def plot_presses(presses: Sequence[SeenPress], ball: Ball, title: str, path: str | Path) -> Path:
    """Draw each press: its circle, slopes told against the ball's, depth, its error and profile.

    Args:
        presses: What is seen; of many, evenly picked ones are drawn.
        ball: What was pressed.
        title: Above all.
        path: Of the picture.
    """
    count = min(_MOST, len(presses))
    picked = [presses[k] for k in np.linspace(0, len(presses) - 1, count).round().astype(int)]
    figure = new_figure(13.0, 2.45 * count + 0.6)
    figure.suptitle(f"{title}\ncontacts as labelled or found (dotted) and fitted", fontsize=10)
    grid = figure.subplots(count, 5, squeeze=False)
    depths = [_depths(one, ball) for one in picked]
    deepest = max(float(np.nanmax(true[inside])) for _, true, inside in depths)
    off = max(float(np.abs((told - true)[inside]).max()) for told, true, inside in depths)
    for line, one, depth in zip(grid, picked, depths, strict=True):
        _draw_image(line[0], one)
        _draw_slopes(line[1], one, ball)
        drawn = _draw_depth(list(line[2:4]), one, ball, depth, deepest, off)
        _draw_profile(line[4], one, ball, depth)
    grid[0, 1].legend(fontsize=7, markerscale=5, loc="upper left", frameon=False)
    grid[0, 4].legend(fontsize=7, loc="upper center", frameon=False, handlelength=1.2)
    for column, image, name in zip((2, 3), drawn, ("depth", "told less true"), strict=True):
        bar = figure.colorbar(image, ax=list(grid[:, column]), aspect=20 * count, pad=0.02)
        bar.set_label(f"{name}, mm", fontsize=8)
        bar.ax.tick_params(labelsize=7)
    for axes in grid.ravel():
        axes.tick_params(labelsize=7)
    for axes, name in zip(
        grid[0], ("contact", "slopes", "depth told", "depth, error", "profile"), strict=True
    ):
        axes.set_title(name, fontsize=9)
    return save_figure(figure, path)


def _depths(one: SeenPress, ball: Ball) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return depth as told and of the ball below the contact's edge, mm, and where to compare."""
    shape = one.known.shape
    inside = ball.distance(shape, one.circle) < _INSIDE
    true = -ball.heights(shape, one.circle)
    told = -one.height_mm
    return told - (told - true)[inside].mean(), true, inside


def _draw_image(axes: Axes, one: SeenPress) -> None:
    axes.imshow(one.image)
    for circle, style in ((one.first, ":"), (one.circle, "-")):
        ring = Round(circle.center_px, circle.radius_px, fill=False, ec="white", lw=1.2, ls=style)
        ring.set_path_effects([withStroke(linewidth=2.6, foreground=EDGE)])
        axes.add_patch(ring)
    axes.set(xticks=[], yticks=[])
    axes.set_ylabel(one.name, fontsize=8)


def _draw_slopes(axes: Axes, one: SeenPress, ball: Ball) -> None:
    inside = one.known & (ball.distance(one.known.shape, one.circle) < _INSIDE)
    true, told = ball.slopes(one.known.shape, one.circle)[inside], one.slopes[inside]
    step = max(1, len(true) // _DOTS)
    end = 1.05 * float(np.abs(true).max())
    axes.plot([-end, end], [-end, end], color="black", lw=0.8)
    for k, (colour, name) in enumerate(((X_COLOUR, "dz/dx"), (Y_COLOUR, "dz/dy"))):
        axes.plot(
            true[::step, k], told[::step, k], ".", ms=1.6, alpha=0.45, color=colour, label=name
        )
    axes.set(xlim=(-end, end), ylim=(-end, end), aspect="equal")
    axes.set_xlabel("of the ball", fontsize=8)
    axes.set_ylabel("told", fontsize=8)


def _draw_depth(
    pair: Sequence[Axes],
    one: SeenPress,
    ball: Ball,
    depth: tuple[np.ndarray, np.ndarray, np.ndarray],
    deepest: float,
    off: float,
) -> tuple[AxesImage, AxesImage]:
    told, true, inside = depth
    x, y = ball.away(one.known.shape, one.circle)
    extent = (float(x[0, 0]), float(x[0, -1]), float(y[-1, 0]), float(y[0, 0]))
    reach = _SHOWN * one.circle.radius_px * ball.mm_per_px[0]
    shown = pair[0].imshow(told, extent=extent, cmap="viridis", vmin=0.0, vmax=deepest)
    error = np.where(inside, told - true, np.nan)
    wrong = pair[1].imshow(error, extent=extent, cmap="coolwarm", vmin=-off, vmax=off)
    for axes in pair:
        axes.set(xlim=(-reach, reach), ylim=(reach, -reach))
        axes.set_xlabel("x, mm", fontsize=8)
        axes.set_ylabel("y, mm", fontsize=8)
    return shown, wrong


def _draw_profile(
    axes: Axes, one: SeenPress, ball: Ball, depth: tuple[np.ndarray, np.ndarray, np.ndarray]
) -> None:
    told, true, _ = depth
    row = int(np.clip(round(one.circle.center_px[1]), 0, told.shape[0] - 1))
    column = int(np.clip(round(one.circle.center_px[0]), 0, told.shape[1] - 1))
    x, y = ball.away(told.shape, one.circle)
    reach = one.circle.radius_px * ball.mm_per_px[0]
    places, heights = x[row], true[row]
    axes.plot(places, np.where(abs(places) <= reach, heights, np.nan), "k--", lw=1.2, label="ball")
    axes.plot(places, told[row], color=X_COLOUR, lw=1.2, label="along x")
    axes.plot(y[:, column], told[:, column], color=Y_COLOUR, lw=1.2, label="along y")
    top = float(np.nanmax(true))
    axes.set(xlim=(-1.2 * reach, 1.2 * reach), ylim=(1.2 * top, -0.6 * top))
    axes.set_xlabel("from the middle, mm", fontsize=8)
    axes.set_ylabel("depth, mm", fontsize=8)

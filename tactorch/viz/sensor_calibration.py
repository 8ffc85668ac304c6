"""Figure of ball presses: contact, slopes and depth by a calibration against the true ball."""

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
from tactorch.text import one_line
from tactorch.viz.figure import BLUE, VERMILION, new_figure, save_figure
from tactorch.viz.sensor_frames import EDGE

_MAX_PRESSES = 8
_INSIDE = 0.9  # compared region, as a fraction of the contact radius
_WINDOW = 1.5  # half width of the depth maps, as a fraction of the contact radius
_MAX_DOTS = 2000
_MAX_NAME = 24


@dataclass(frozen=True, eq=False)
class BallPress:
    """A press of a ball, measured by a calibration.

    Attributes:
        name: Name of the image.
        image: Image of the press.
        initial: Circle of the contact, as labelled or detected.
        circle: Fitted circle of the contact.
        known: Pixels without markers, (h, w).
        slopes: Slopes dz/dx and dz/dy by the calibration, (h, w, 2).
        height_mm: Integrated height, mm (h, w).
    """

    name: str
    image: Image
    initial: Circle
    circle: Circle
    known: Bool[np.ndarray, "h w"]
    slopes: Float[np.ndarray, "h w 2"]
    height_mm: Float[np.ndarray, "h w"]


def plot_ball_presses(
    presses: Sequence[BallPress], ball: Ball, title: str, path: str | Path
) -> Path:
    """Draw contact, measured against true slopes, depth, depth error and profile of each press.

    Args:
        presses: Presses; of many, evenly selected ones are drawn.
        ball: Ball that was pressed.
        title: Title of the figure.
        path: Path of the png, pdf or svg file.

    Returns:
        The path.
    """
    count = min(_MAX_PRESSES, len(presses))
    selected = [presses[k] for k in np.linspace(0, len(presses) - 1, count).round().astype(int)]
    figure = new_figure(13.0, 2.45 * count + 0.6)
    figure.suptitle(
        f"{title}\ncontacts as labelled or detected (dotted) and fitted (solid)", fontsize=10
    )
    grid = figure.subplots(count, 5, squeeze=False)
    depths = [_depths(press, ball) for press in selected]
    deepest = max(float(np.nanmax(true[inside])) for _, true, inside in depths)
    max_error = max(float(np.abs((depth - true)[inside]).max()) for depth, true, inside in depths)
    for line, press, depth in zip(grid, selected, depths, strict=True):
        _draw_image(line[0], press)
        _draw_slopes(line[1], press, ball)
        images = _draw_depth(list(line[2:4]), press, ball, depth, deepest, max_error)
        _draw_profile(line[4], press, ball, depth)
    grid[0, 1].legend(fontsize=7, markerscale=5, loc="upper left", frameon=False)
    grid[0, 4].legend(fontsize=7, loc="upper center", frameon=False, handlelength=1.2)
    for column, image, name in zip((2, 3), images, ("depth", "measured less true"), strict=True):
        bar = figure.colorbar(image, ax=list(grid[:, column]), aspect=20 * count, pad=0.02)
        bar.set_label(f"{name}, mm", fontsize=8)
        bar.ax.tick_params(labelsize=7)
    for axes in grid.ravel():
        axes.tick_params(labelsize=7)
    for axes, name in zip(
        grid[0], ("contact", "slopes", "depth", "depth error", "profile"), strict=True
    ):
        axes.set_title(name, fontsize=9)
    return save_figure(figure, path)


def _depths(press: BallPress, ball: Ball) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return measured and true depth below the edge of the contact, mm, and the region compared."""
    shape = press.known.shape
    inside = ball.distance(shape, press.circle) < _INSIDE
    true = -ball.heights(shape, press.circle)
    depth = -press.height_mm
    return depth - (depth - true)[inside].mean(), true, inside


def _draw_image(axes: Axes, press: BallPress) -> None:
    axes.imshow(press.image)
    for circle, style in ((press.initial, ":"), (press.circle, "-")):
        ring = Round(circle.center_px, circle.radius_px, fill=False, ec="white", lw=1.2, ls=style)
        ring.set_path_effects([withStroke(linewidth=2.6, foreground=EDGE)])
        axes.add_patch(ring)
    axes.set(xticks=[], yticks=[])
    axes.set_ylabel(one_line(press.name, _MAX_NAME), fontsize=8)


def _draw_slopes(axes: Axes, press: BallPress, ball: Ball) -> None:
    inside = press.known & (ball.distance(press.known.shape, press.circle) < _INSIDE)
    true = ball.slopes(press.known.shape, press.circle)[inside]
    measured = press.slopes[inside]
    step = max(1, len(true) // _MAX_DOTS)
    end = 1.05 * float(np.abs(true).max())
    axes.plot([-end, end], [-end, end], color="black", lw=0.8)
    for k, (colour, name) in enumerate(((BLUE, "dz/dx"), (VERMILION, "dz/dy"))):
        axes.plot(
            true[::step, k], measured[::step, k], ".", ms=1.6, alpha=0.45, color=colour, label=name
        )
    axes.set(xlim=(-end, end), ylim=(-end, end), aspect="equal")
    axes.set_xlabel("true", fontsize=8)
    axes.set_ylabel("measured", fontsize=8)


def _draw_depth(
    pair: Sequence[Axes],
    press: BallPress,
    ball: Ball,
    depth: tuple[np.ndarray, np.ndarray, np.ndarray],
    deepest: float,
    max_error: float,
) -> tuple[AxesImage, AxesImage]:
    measured, true, inside = depth
    x, y = ball.offsets(press.known.shape, press.circle)
    extent = (float(x[0, 0]), float(x[0, -1]), float(y[-1, 0]), float(y[0, 0]))
    reach = _WINDOW * press.circle.radius_px * ball.mm_per_px[0]
    shown = pair[0].imshow(measured, extent=extent, cmap="viridis", vmin=0.0, vmax=deepest)
    error = np.where(inside, measured - true, np.nan)
    errors = pair[1].imshow(error, extent=extent, cmap="coolwarm", vmin=-max_error, vmax=max_error)
    for axes in pair:
        axes.set(xlim=(-reach, reach), ylim=(reach, -reach))
        axes.set_xlabel("x, mm", fontsize=8)
        axes.set_ylabel("y, mm", fontsize=8)
    return shown, errors


def _draw_profile(
    axes: Axes, press: BallPress, ball: Ball, depth: tuple[np.ndarray, np.ndarray, np.ndarray]
) -> None:
    measured, true, _ = depth
    row = int(np.clip(round(press.circle.center_px[1]), 0, measured.shape[0] - 1))
    column = int(np.clip(round(press.circle.center_px[0]), 0, measured.shape[1] - 1))
    x, y = ball.offsets(measured.shape, press.circle)
    reach = press.circle.radius_px * ball.mm_per_px[0]
    distances = x[row]
    axes.plot(
        distances, np.where(abs(distances) <= reach, true[row], np.nan), "k--", lw=1.2, label="ball"
    )
    axes.plot(distances, measured[row], color=BLUE, lw=1.2, label="along x")
    axes.plot(y[:, column], measured[:, column], color=VERMILION, lw=1.2, label="along y")
    top = float(np.nanmax(true))
    axes.set(xlim=(-1.2 * reach, 1.2 * reach), ylim=(1.2 * top, -0.6 * top))
    axes.set_xlabel("distance from the centre, mm", fontsize=8)
    axes.set_ylabel("depth, mm", fontsize=8)

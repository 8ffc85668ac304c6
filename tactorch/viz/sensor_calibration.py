"""Figure of ball presses: contact, slopes and depth by a calibration against the true ball."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle as Round
from matplotlib.patheffects import withStroke

from tactorch.sensor.calibration import Ball, BallPress
from tactorch.sensor.frames import Image
from tactorch.text import one_line
from tactorch.viz.figure import BLUE, VERMILION, new_grid
from tactorch.viz.sensor_frames import EDGE

_MAX_PRESSES = 8
_INSIDE = 0.9  # compared region, as a fraction of the contact radius
_WINDOW = 1.5  # half width of the depth maps, as a fraction of the contact radius
_MAX_DOTS = 2000
_MAX_NAME = 24
_COLUMNS = ("contact", "slopes", "depth", "depth error", "profile")


@dataclass(frozen=True, eq=False)
class PlottedPress:
    """A press of a ball, measured by a calibration.

    `slopes` are dz/dx and dz/dy by the calibration, integrated to `height_mm`.
    """

    press: BallPress
    image: Image
    ball: Ball
    slopes: Float[np.ndarray, "h w 2"]
    height_mm: Float[np.ndarray, "h w"]

    @cached_property
    def inside(self) -> Bool[np.ndarray, "h w"]:
        """Pixels that are compared."""
        return self.ball.distance(self.press.shape, self.press.contact) < _INSIDE

    @cached_property
    def true_depth_mm(self) -> Float[np.ndarray, "h w"]:
        """True depth below the edge of the contact."""
        return -self.ball.heights(self.press.shape, self.press.contact)

    @cached_property
    def depth_mm(self) -> Float[np.ndarray, "h w"]:
        """Measured depth below the edge of the contact."""
        depth = -self.height_mm
        return depth - (depth - self.true_depth_mm)[self.inside].mean()

    @property
    def error_mm(self) -> Float[np.ndarray, "h w"]:
        """Error of the depth; NaN where it is not compared."""
        return np.where(self.inside, self.depth_mm - self.true_depth_mm, np.nan)

    @cached_property
    def offset_mm(self) -> Float[np.ndarray, "2 h w"]:
        """Offset of each pixel from the center of the contact along x and y."""
        return self.ball.offsets(self.press.shape, self.press.contact)

    @property
    def radius_mm(self) -> float:
        """Radius of the contact, mm."""
        return self.press.contact.radius_px * self.ball.mm_per_px[0]


def ball_press_figure(presses: Sequence[PlottedPress], title: str) -> Figure:
    """Return a figure of contact, slopes, depth, depth error and profile of each press.

    Of many presses, evenly selected ones are drawn.
    """
    count = min(_MAX_PRESSES, len(presses))
    selected = [presses[k] for k in np.linspace(0, len(presses) - 1, count).round().astype(int)]
    figure, grid = new_grid(13.0, 2.45 * count + 0.6, count, len(_COLUMNS))
    figure.suptitle(
        f"{title}\ncontacts as labelled or detected (dotted) and fitted (solid)", fontsize=10
    )
    deepest = max(float(np.nanmax(press.true_depth_mm[press.inside])) for press in selected)
    max_error = max(float(np.nanmax(np.abs(press.error_mm))) for press in selected)
    for line, press in zip(grid, selected, strict=True):
        _draw_image(line[0], press)
        _draw_slopes(line[1], press)
        _draw_map(line[2], press, press.depth_mm, "viridis", 0.0, deepest)
        _draw_map(line[3], press, press.error_mm, "coolwarm", -max_error, max_error)
        _draw_profile(line[4], press)
    grid[0, 1].legend(fontsize=7, markerscale=5, loc="upper left", frameon=False)
    grid[0, 4].legend(fontsize=7, loc="upper center", frameon=False, handlelength=1.2)
    for column, name in ((2, "depth"), (3, "measured less true")):
        panels = list(grid[:, column])
        bar = figure.colorbar(panels[-1].images[0], ax=panels, aspect=20 * count, pad=0.02)
        bar.set_label(f"{name}, mm", fontsize=8)
        bar.ax.tick_params(labelsize=7)
    for axes in grid.ravel():
        axes.tick_params(labelsize=7)
    for axes, name in zip(grid[0], _COLUMNS, strict=True):
        axes.set_title(name, fontsize=9)
    return figure


def _label(axes: Axes, xlabel: str, ylabel: str) -> None:
    axes.set_xlabel(xlabel, fontsize=8)
    axes.set_ylabel(ylabel, fontsize=8)


def _draw_image(axes: Axes, press: PlottedPress) -> None:
    axes.imshow(press.image)
    for circle, style in ((press.press.circle, ":"), (press.press.contact, "-")):
        ring = Round(circle.center_px, circle.radius_px, fill=False, ec="white", lw=1.2, ls=style)
        ring.set_path_effects([withStroke(linewidth=2.6, foreground=EDGE)])
        axes.add_patch(ring)
    axes.set(xticks=[], yticks=[])
    axes.set_ylabel(one_line(press.press.name, _MAX_NAME), fontsize=8)


def _draw_slopes(axes: Axes, press: PlottedPress) -> None:
    inside = press.press.known & press.inside
    true = press.ball.slopes_at(press.offset_mm)[inside]
    step = max(1, len(true) // _MAX_DOTS)
    x, y = true[::step], press.slopes[inside][::step]
    end = 1.05 * float(np.abs(true).max())
    axes.plot([-end, end], [-end, end], color="black", lw=0.8)
    for k, (colour, name) in enumerate(((BLUE, "dz/dx"), (VERMILION, "dz/dy"))):
        axes.plot(x[:, k], y[:, k], ".", ms=1.6, alpha=0.45, color=colour, label=name)
    axes.set(xlim=(-end, end), ylim=(-end, end), aspect="equal")
    _label(axes, "true", "measured")


def _draw_map(
    axes: Axes, press: PlottedPress, values: np.ndarray, cmap: str, low: float, high: float
) -> None:
    x, y = press.offset_mm
    extent = (float(x[0, 0]), float(x[0, -1]), float(y[-1, 0]), float(y[0, 0]))
    reach = _WINDOW * press.radius_mm
    axes.imshow(values, extent=extent, cmap=cmap, vmin=low, vmax=high)
    axes.set(xlim=(-reach, reach), ylim=(reach, -reach))
    _label(axes, "x, mm", "y, mm")


def _draw_profile(axes: Axes, press: PlottedPress) -> None:
    depth, true, reach = press.depth_mm, press.true_depth_mm, press.radius_mm
    center = np.round(press.press.contact.center_px).astype(int)[::-1]
    row, column = np.clip(center, 0, np.array(depth.shape) - 1)
    x, y = press.offset_mm
    ball = np.where(abs(x[row]) <= reach, true[row], np.nan)
    axes.plot(x[row], ball, "k--", lw=1.2, label="ball")
    axes.plot(x[row], depth[row], color=BLUE, lw=1.2, label="along x")
    axes.plot(y[:, column], depth[:, column], color=VERMILION, lw=1.2, label="along y")
    top = float(np.nanmax(true))
    axes.set(xlim=(-1.2 * reach, 1.2 * reach), ylim=(1.2 * top, -0.6 * top))
    _label(axes, "distance from the centre, mm", "depth, mm")

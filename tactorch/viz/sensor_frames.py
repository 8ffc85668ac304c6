"""Views of a sensor's frames: markers, depth and force, redrawn for each frame.

`show` of a view draws a frame: its image, or None, values measured in it, and a title.
"""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation

from tactorch.mesh.geometry import vertex_areas
from tactorch.sensor.description import SensorDescription
from tactorch.sensor.frames import Image
from tactorch.viz.figure import VERMILION, new_figure

DPI = 110
#: Edge colour of what is drawn over an image, visible on light and dark.
EDGE = "black"
_KPA_PER_MPA = 1e3
_MIN_SHEAR = 0.04  # arrows below this fraction of the longest are not drawn


def image_extent(sensor: SensorDescription) -> tuple[float, float, float, float]:
    """Return left, right, bottom and top of the sensor's images for `imshow`, mm, y downward."""
    width, height = sensor.image_size_px
    left, top = sensor.to_mm(np.array([-0.5, -0.5]))
    right, bottom = sensor.to_mm(np.array([width - 0.5, height - 0.5]))
    return float(left), float(right), float(bottom), float(top)


def faded(image: Image) -> Image:
    """Return an image in light greys, as background of colours."""
    grey = image.mean(axis=2)
    low, high = np.percentile(grey, (1, 99))
    scaled = np.clip((grey - low) / max(float(high - low), 1.0), 0.0, 1.0)
    return np.repeat((110 + 130 * scaled).astype(np.uint8)[..., None], 3, axis=2)


def render(figure: Figure) -> Image:
    """Return a figure as an RGB image of even width and height, as video codecs require."""
    canvas = figure.canvas
    assert isinstance(canvas, FigureCanvasAgg)
    figure.set_dpi(DPI)
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())[..., :3]
    height, width = (n - n % 2 for n in pixels.shape[:2])
    return np.ascontiguousarray(pixels[:height, :width])


def colour_limit(values: Float[np.ndarray, "..."], minimum: float) -> float:
    """Return the upper end of a colour scale: the 99.9th percentile, or `minimum` if larger."""
    known = values[np.isfinite(values)]
    return max(float(np.percentile(known, 99.9)), minimum) if known.size else minimum


class FrameView:
    """Figure of panels side by side, with the image of a frame in the first, on axes in mm.

    Panels are at most `width` inches wide and high.
    """

    def __init__(self, sensor: SensorDescription, panels: int, width: float) -> None:
        self.sensor = sensor
        ratio = sensor.size_mm[1] / sensor.size_mm[0]
        across = min(width, width / ratio)
        self.figure: Figure = new_figure(panels * (across + 0.65) + 1.0, across * ratio + 1.15)
        self.axes: list[Axes] = list(self.figure.subplots(1, panels, squeeze=False)[0])
        self.axes[0].set(xlabel="x, mm", ylabel="y, mm")
        self.extent = image_extent(sensor)
        self._blank = np.full((*sensor.shape, 3), 200, np.uint8)
        self._image = self.axes[0].imshow(self._blank, extent=self.extent)
        self._title = self.axes[0].set_title("frame\n ", fontsize=10, loc="left")

    def _fix_layout(self) -> None:
        """Compute the layout once for all frames."""
        self.figure.canvas.draw()
        self.figure.set_layout_engine("none")

    def _show_image(self, image: Image | None, caption: str) -> None:
        self._image.set_data(self._blank if image is None else image)
        self._title.set_text(caption)


class MarkerView(FrameView):
    """A frame with an arrow from the position of each marker in the reference to its position.

    The colour scale ends at `largest_mm`; arrows that are not magnified end at their markers.
    """

    def __init__(
        self,
        sensor: SensorDescription,
        begin_px: Float[np.ndarray, "n 2"],
        largest_mm: float,
        magnify: float = 1.0,
    ) -> None:
        super().__init__(sensor, 1, 6.6)
        (axes,) = self.axes
        self.rest = sensor.to_mm(begin_px)
        zeros = np.zeros(len(self.rest))
        self._arrows = axes.quiver(
            *self.rest.T, zeros, zeros, zeros, angles="xy", scale_units="xy", scale=1.0 / magnify,
            cmap="viridis", clim=(0.0, largest_mm), width=0.0045, edgecolor=EDGE, linewidth=0.5,
            zorder=3,
        )  # fmt: skip
        (self._lost,) = axes.plot([], [], "x", color=VERMILION, ms=6, mew=1.6, label="lost")
        times = "" if magnify == 1.0 else f" (arrows magnified {magnify:g} times)"
        label = f"tangential displacement, mm{times}"
        self.figure.colorbar(self._arrows, ax=axes, fraction=0.04, pad=0.02, label=label)
        self._fix_layout()

    def show(
        self, image: Image | None, positions_px: Float[np.ndarray, "n 2"], caption: str
    ) -> None:
        """Draw a frame by the positions of its markers, px; NaN if lost."""
        self._show_image(None if image is None else faded(image), caption)
        shift = self.sensor.to_mm(positions_px) - self.rest
        lost = np.isnan(shift).any(axis=1)
        masked = np.ma.masked_array(shift, np.broadcast_to(lost[:, None], shift.shape))
        self._arrows.set_UVC(masked[:, 0], masked[:, 1], np.ma.hypot(masked[:, 0], masked[:, 1]))
        self._lost.set_data(*self.rest[lost].T)


class DepthView(FrameView):
    """A frame, and a map of the indentation depth of the gel surface up to `deepest_mm`."""

    def __init__(self, sensor: SensorDescription, deepest_mm: float) -> None:
        super().__init__(sensor, 2, 5.0)
        self._depth = self.axes[1].imshow(
            np.zeros(sensor.shape), extent=self.extent, cmap="viridis", vmin=0.0, vmax=deepest_mm
        )
        self.axes[1].set(xlabel="x, mm")
        self.axes[1].set_title("white: contact\n ", fontsize=10, loc="left")
        bar = self.figure.colorbar(self._depth, ax=self.axes[1], extend="min", pad=0.02)
        bar.set_label("depth, mm")
        self._outlines: list[Any] = []
        self._fix_layout()

    def show(
        self,
        image: Image | None,
        height_mm: Float[np.ndarray, "h w"],
        contact: Bool[np.ndarray, "h w"],
        caption: str,
    ) -> None:
        """Draw a frame by the height of its surface, mm, negative if indented; NaN if unknown."""
        self._show_image(image, caption)
        self._depth.set_data(-height_mm)
        for outline in self._outlines:
            outline.remove()
        self._outlines = []
        if contact.any() and not contact.all():
            self._outlines = [
                axes.contour(
                    contact.astype(float), [0.5], extent=self.extent, origin="upper",
                    colors="white", linewidths=1.3,
                )
                for axes in self.axes
            ]  # fmt: skip


class ForceView(FrameView):
    """A frame, and the traction on the gel surface: pressure as colour, shear as arrows.

    `largest_mpa` are the upper end of the colour scale and the shear of the longest arrow.
    """

    def __init__(
        self,
        sensor: SensorDescription,
        points: Float[np.ndarray, "k 3"],
        triangles: Int[np.ndarray, "t 3"],
        largest_mpa: tuple[float, float],
    ) -> None:
        super().__init__(sensor, 2, 5.0)
        axes = self.axes[1]
        self._area = vertex_areas(points, triangles)
        x, y = points[:, 0], points[:, 1]
        self._mesh = axes.tripcolor(
            Triangulation(x, y, triangles), np.zeros(len(points)), shading="gouraud",
            cmap="cividis", vmin=0.0, vmax=_KPA_PER_MPA * largest_mpa[0],
        )  # fmt: skip
        # The longest arrow has the length of three cells.
        cell = float(np.sqrt(self._area.mean()))
        self._longest = _KPA_PER_MPA * largest_mpa[1]
        zeros = np.zeros(len(points))
        self._arrows = axes.quiver(
            x, y, zeros, zeros, angles="xy", scale_units="xy", scale=self._longest / (3.0 * cell),
            color="white", edgecolor=EDGE, linewidth=0.5, width=0.005, zorder=3,
        )  # fmt: skip
        axes.quiverkey(
            self._arrows, 0.86, 1.03, self._longest, f"shear {self._longest:.3g} kPa",
            labelpos="W", fontproperties={"size": 9},
        )  # fmt: skip
        axes.set(xlabel="x, mm", aspect="equal", facecolor="0.85")
        axes.set(xlim=self.extent[:2], ylim=self.extent[2:])
        self.figure.colorbar(self._mesh, ax=axes, extend="both", pad=0.02, label="pressure, kPa")
        self._fix_layout()

    def show(
        self, image: Image | None, forces: Float[np.ndarray, "k 3"] | None, caption: str
    ) -> None:
        """Draw a frame by the force of each node on the gel, N; None for no force."""
        self._show_image(image, caption)
        traction = np.zeros((len(self._area), 3)) if forces is None else forces
        traction = _KPA_PER_MPA * np.nan_to_num(traction) / self._area[:, None]
        self._mesh.set_array(-traction[:, 2])
        weak = np.linalg.norm(traction[:, :2], axis=1) < _MIN_SHEAR * self._longest
        shear = np.ma.masked_array(traction[:, :2], np.repeat(weak[:, None], 2, axis=1))
        self._arrows.set_UVC(shear[:, 0], shear[:, 1])

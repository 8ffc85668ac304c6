"""Arrows on a frame: how markers moved."""

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from tactorch.sensor.description import SensorDescription
from tactorch.sensor.frames import Image
from tactorch.viz.sensor_frame import EDGE, blank, faded, frame_figure, image_axes, settle

_LOST = "#D55E00"


class MarkerView:
    """A frame with an arrow for each marker, from where it rests to where it is.

    Args:
        sensor: The sensor.
        begin_px: Markers in the reference (column, row).
        largest_mm: Upper end of the colours.
        magnify: Of arrows; 1 ends them on their markers.
    """

    def __init__(
        self,
        sensor: SensorDescription,
        begin_px: Float[np.ndarray, "n 2"],
        largest_mm: float,
        magnify: float = 1.0,
    ) -> None:
        self.sensor, self.rest = sensor, sensor.to_mm(begin_px)
        self.figure: Figure = frame_figure(sensor, 1, 6.6)
        axes = self.figure.subplots()
        self._image = image_axes(axes, sensor)
        none = np.zeros(len(self.rest))
        self._arrows = axes.quiver(
            *self.rest.T, none, none, none, angles="xy", scale_units="xy", scale=1.0 / magnify,
            cmap="viridis", clim=(0.0, largest_mm), width=0.0045, edgecolor=EDGE, linewidth=0.5,
            zorder=3,
        )  # fmt: skip
        (self._lost,) = axes.plot([], [], "x", color=_LOST, ms=6, mew=1.6, label="not seen")
        self._title = axes.set_title("frame\n ", fontsize=10, loc="left")
        bar = self.figure.colorbar(self._arrows, ax=axes, fraction=0.04, pad=0.02)
        times = "" if magnify == 1.0 else f" (arrows {magnify:g} times as long)"
        bar.set_label(f"displacement along the face, mm{times}")
        settle(self.figure)

    def show(self, image: Image | None, places_px: Float[np.ndarray, "n 2"], caption: str) -> None:
        """Draw a frame; without an image there are no arrows."""
        self._image.set_data(blank(self.sensor) if image is None else faded(image))
        moved = self.sensor.to_mm(places_px) - self.rest
        lost = np.isnan(moved).any(axis=1)
        hidden = np.ma.masked_array(moved, np.broadcast_to(lost[:, None], moved.shape))
        self._arrows.set_UVC(hidden[:, 0], hidden[:, 1], np.ma.hypot(hidden[:, 0], hidden[:, 1]))
        self._lost.set_data(*self.rest[lost].T)
        self._title.set_text(caption)

"""A frame beside the depth of the gel's face."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.figure import Figure

from tactorch.sensor.description import SensorDescription
from tactorch.sensor.frames import Image
from tactorch.viz.sensor_frame import blank, extent_of, frame_figure, image_axes, settle

_OUTLINE = "white"


class DepthView:
    """A frame, and a map of how deep the gel's face is pressed in.

    Args:
        sensor: The sensor.
        deepest_mm: Upper end of the colours.
    """

    def __init__(self, sensor: SensorDescription, deepest_mm: float) -> None:
        self.sensor, self.extent = sensor, extent_of(sensor)
        self.figure: Figure = frame_figure(sensor, 2, 5.0)
        self._axes = self.figure.subplots(1, 2)
        self._image = image_axes(self._axes[0], sensor)
        self._depth = self._axes[1].imshow(
            np.zeros(sensor.shape), extent=self.extent, cmap="viridis", vmin=0.0, vmax=deepest_mm
        )
        self._axes[1].set(xlabel="x, mm")
        self._title = self._axes[0].set_title("frame\n ", fontsize=10, loc="left")
        self._axes[1].set_title("white: contact\n ", fontsize=10, loc="left")
        bar = self.figure.colorbar(self._depth, ax=self._axes[1], extend="min", pad=0.02)
        bar.set_label("depth, mm")
        self._outlines: list[Any] = []
        settle(self.figure)

    def show(
        self,
        image: Image | None,
        height_mm: Float[np.ndarray, "h w"],
        contact: Bool[np.ndarray, "h w"],
        caption: str,
    ) -> None:
        """Draw a frame; heights (negative where pressed in) are NaN where nothing is known."""
        self._image.set_data(blank(self.sensor) if image is None else image)
        self._depth.set_data(-height_mm)
        for outline in self._outlines:
            outline.remove()
        self._outlines = []
        if contact.any() and not contact.all():
            self._outlines = [
                axes.contour(
                    contact.astype(float), [0.5], extent=self.extent, origin="upper",
                    colors=_OUTLINE, linewidths=1.3,
                )
                for axes in self._axes
            ]  # fmt: skip
        self._title.set_text(caption)

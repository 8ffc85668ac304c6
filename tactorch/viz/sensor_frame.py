"""What pictures of a sensor's frames share: axes in mm over an image, drawn anew for each frame."""

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

from tactorch.sensor.description import SensorDescription
from tactorch.sensor.frames import Image
from tactorch.viz._figure import new_figure

Extent = tuple[float, float, float, float]
DPI = 110
#: Edge of what is drawn over an image, so that it shows on light and dark alike.
EDGE = "black"


def extent_of(sensor: SensorDescription) -> Extent:
    """Return left, right, bottom and top of the sensor's images for `imshow`, mm, y downward."""
    width, height = sensor.image_size_px
    left, top = sensor.to_mm(np.array([-0.5, -0.5]))
    right, bottom = sensor.to_mm(np.array([width - 0.5, height - 0.5]))
    return float(left), float(right), float(bottom), float(top)


def frame_figure(sensor: SensorDescription, panels: int, wide: float) -> Figure:
    """Return an empty figure for so many images of a sensor in a row, and a colour bar.

    Args:
        sensor: The sensor.
        panels: Images side by side.
        wide: Width of each where it is not taller than wide, inches.
    """
    ratio = sensor.size_mm[1] / sensor.size_mm[0]
    across = min(wide, wide / ratio)
    return new_figure(panels * (across + 0.65) + 1.0, across * ratio + 1.15)


def image_axes(axes: Axes, sensor: SensorDescription) -> AxesImage:
    """Put an empty image on axes in mm, and return it to be filled."""
    axes.set(xlabel="x, mm", ylabel="y, mm")
    return axes.imshow(blank(sensor), extent=extent_of(sensor))


def blank(sensor: SensorDescription) -> Image:
    """Return what is shown where a frame has no image."""
    return np.full((*sensor.shape, 3), 200, np.uint8)


def faded(image: Image) -> Image:
    """Return an image in light greys, for colours to stand out on it."""
    grey = image.mean(axis=2)
    low, high = np.percentile(grey, (1, 99))
    even = np.clip((grey - low) / max(float(high - low), 1.0), 0.0, 1.0)
    return np.repeat((110 + 130 * even).astype(np.uint8)[..., None], 3, axis=2)


def settle(figure: Figure) -> None:
    """Lay a figure out once, for all frames that are drawn with it."""
    figure.canvas.draw()
    figure.set_layout_engine("none")


def as_image(figure: Figure) -> Image:
    """Draw a figure as it is now; width and height are even, as videos want them."""
    canvas = figure.canvas
    assert isinstance(canvas, FigureCanvasAgg)
    figure.set_dpi(DPI)
    canvas.draw()
    drawn = np.asarray(canvas.buffer_rgba())[..., :3]
    height, width = (n - n % 2 for n in drawn.shape[:2])
    return np.ascontiguousarray(drawn[:height, :width])


def largest(values: Float[np.ndarray, "..."], least: float) -> float:
    """Return the upper end of a colour scale: the largest value but for lone outliers."""
    known = values[np.isfinite(values)]
    return max(float(np.percentile(known, 99.9)), least) if known.size else least

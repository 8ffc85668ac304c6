"""Figures of datasets with a tactile sensor."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tactorch.errors import ConfigError
from tactorch.generation import Sample
from tactorch.text import one_line
from tactorch.touch import Touch
from tactorch.viz.figure import new_grid

_MAX_SAMPLES = 6
_MAX_NAME = 24
_ARROW = 8.0  # length of arrows over the motion of the markers
_CONTRAST = 2.0  # of the difference to the image without contact


def touch_figure(samples: Sequence[Sample]) -> Figure:
    """Return a figure of the last press of some samples that have a touch.

    Rows are the image with the motion of the markers (8 times as long), the difference to the
    image without contact, and the height of the gel's face. Titles have the force on the gel.

    Raises:
        ConfigError: No sample has a touch.
    """
    with_touch = [sample for sample in samples if sample.touch is not None]
    if not with_touch:
        raise ConfigError("no sample has images of a sensor; generate dataset=touch.")
    shown = with_touch[:: max(1, len(with_touch) // _MAX_SAMPLES)][:_MAX_SAMPLES]
    has_heights = all(sample.touch.height_mm is not None for sample in shown)  # type: ignore[union-attr]
    names = ("image, markers x 8", "difference x 2", "height")[: 3 if has_heights else 2]
    rows = len(names)
    figure, grid = new_grid(2.3 * len(shown) + 0.8, 1.75 * rows, rows, len(shown))
    for column, sample in zip(grid.T, shown, strict=True):
        assert sample.touch is not None
        _draw(column, sample.touch)
        force = -float(sample.touch.total_force[-1, 2])
        body = one_line(str(sample.facts.get("body", sample.label)), _MAX_NAME)
        column[0].set_title(f"{sample.index}: {body}, {force:.2f} N", fontsize=8)
    for axes, name in zip(grid[:, 0], names, strict=True):
        axes.set_ylabel(name, fontsize=8)
    return figure


def _draw(column: np.ndarray, touch: Touch) -> None:
    image = touch.images[-1]
    column[0].imshow(image)
    rest = touch.rest_markers_px
    if len(rest):
        moved = _ARROW * (touch.markers_px[-1] - rest)
        column[0].quiver(
            *rest.T, *moved.T, angles="xy", scale_units="xy", scale=1.0, color="white", width=0.008
        )
    change = image.astype(float) - touch.reference
    column[1].imshow(np.clip(127.0 + _CONTRAST * change, 0, 255).astype(np.uint8))
    if touch.height_mm is not None and len(column) > 2:
        _with_scale(column[2], touch.height_mm[-1], "mm")
    for axes in column:
        axes.set(xticks=[], yticks=[])


def _with_scale(axes: Axes, values: np.ndarray, unit: str) -> None:
    drawn = axes.imshow(values, cmap="viridis")
    bar = axes.figure.colorbar(drawn, ax=axes, shrink=0.8)
    bar.ax.tick_params(labelsize=6)
    bar.set_label(unit, fontsize=6)

"""Figures without a display: creation, text from files, colours and atomic saving."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import LogFormatter

from tactorch.errors import ConfigError
from tactorch.files import atomic_path
from tactorch.text import printable

FORMATS = (".png", ".pdf", ".svg")
#: Okabe and Ito's colours, which colour-blind readers can distinguish.
BLUE, VERMILION, GREEN, PURPLE = "#0072B2", "#D55E00", "#009E73", "#CC79A7"
COLOURS = (BLUE, VERMILION, GREEN, PURPLE, "#E69F00", "#56B4E9", "#000000")
#: Colour of contact: differs from every colour of viridis and cividis.
CONTACT = VERMILION
MODULUS_LABEL = "Young's modulus (MPa)"


class PlainTextFigure(Figure):
    """Figure whose text is never parsed as mathtext, except the labels of logarithmic axes."""

    def draw(self, renderer: Any) -> None:
        """Draw the figure; see `matplotlib.figure.Figure.draw`."""
        generated = {id(label) for label in self._log_tick_labels()}
        for text in self.findobj(Text):
            if isinstance(text, Text) and id(text) not in generated:
                text.set_parse_math(False)
                text.set_text(printable(text.get_text()))
        super().draw(renderer)

    def _log_tick_labels(self) -> list[Text]:
        axes: list[Axis] = [axis for one in self.axes for axis in (one.xaxis, one.yaxis)]
        ticks = [
            tick
            for axis in axes
            if isinstance(axis.get_major_formatter(), LogFormatter)
            for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks())
        ]
        return [label for tick in ticks for label in (tick.label1, tick.label2)]


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure that is independent of pyplot's state.

    Args:
        width: Width, inches.
        height: Height, inches.
    """
    figure = PlainTextFigure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def save_figure(figure: Figure, path: str | Path, dpi: int = 130) -> Path:
    """Write a figure atomically; the suffix of `path` gives the format.

    Returns:
        The path.

    Raises:
        ConfigError: The suffix is none of png, pdf and svg.
    """
    target = Path(path)
    if target.suffix.lower() not in FORMATS:
        raise ConfigError(f"'{target}': a picture's name ends in one of {', '.join(FORMATS)}.")
    with atomic_path(target) as temporary:
        figure.savefig(temporary, dpi=dpi)
    return target


def require_curves(function: str, curves: Mapping[str, Any]) -> None:
    """Raise `ConfigError` if there is no curve, or a group of curves is empty."""
    groups = [value for value in curves.values() if isinstance(value, Mapping)]
    if not curves or not all(groups):
        raise ConfigError(f"{function}: no curve given; pass at least one.")

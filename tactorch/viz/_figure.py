"""Figures that need no display, saved whole or not at all."""

from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from tactorch.errors import ConfigError
from tactorch.files import atomic_path

FORMATS = (".png", ".pdf", ".svg")


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure of the given size in inches, apart from pyplot's state."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def save_figure(figure: Figure, path: str | Path, dpi: int = 130) -> Path:
    """Write a figure atomically; the suffix of `path` gives the format.

    Raises:
        ConfigError: The suffix is none of png, pdf and svg.
    """
    target = Path(path)
    if target.suffix.lower() not in FORMATS:
        raise ConfigError(f"'{target}': a picture's name ends in one of {', '.join(FORMATS)}.")
    with atomic_path(target) as temporary:
        figure.savefig(temporary, dpi=dpi)
    return target

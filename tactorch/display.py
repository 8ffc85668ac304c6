"""Text and pictures of an object, in notebooks and scripts."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pyvista
    from matplotlib.figure import Figure

#: Functions that show an object: `make_figure`, `make_html`, `to_pyvista`, `show`, `report_of` and
#: `summarize`. The package registers them, as they are in modules that import the objects.
VIEWS: dict[str, Callable[..., Any]] = {}


class Summarized(ABC):
    """An object that prints as a few lines."""

    @abstractmethod
    def summary(self) -> str:
        """Return a description in a few lines of text."""

    def __repr__(self) -> str:
        lines = self.summary().splitlines()
        return "\n  ".join([type(self).__name__, *lines])


class Displayed(Summarized):
    """An object with a summary, a figure and a view in three dimensions.

    Notebooks show the summary and the figure where an object is the last value of a cell.
    """

    def plot(self, **options: Any) -> "Figure":
        """Return a figure. `tactorch.viz.figures` lists figures and options for each type."""
        figure: Figure = VIEWS["make_figure"](self, **options)
        return figure

    def to_pyvista(self) -> "pyvista.DataObject":
        """Return the object for PyVista, lengths in mm; see `tactorch.viz.solid`.

        Raises:
            ConfigError: PyVista is not installed.
        """
        return VIEWS["to_pyvista"](self)

    def show(self, *, screenshot: str | Path | None = None, **options: Any) -> None:
        """Show the object in three dimensions with PyVista.

        Args:
            screenshot: File for a picture instead of a window, such as `view.png`.
            options: Options of `pyvista.Plotter.show`, such as `jupyter_backend="static"`.

        Raises:
            ConfigError: PyVista is not installed, or there is no window system, notebook or file.
        """
        VIEWS["show"](self, screenshot, **options)

    def _repr_html_(self) -> str:
        """Return the summary and the figure for a notebook."""
        text: str = VIEWS["make_html"](self)
        return text

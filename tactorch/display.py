"""Text and pictures of an object, in notebooks and scripts."""

from abc import ABC, abstractmethod
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pyvista
    from matplotlib.figure import Figure

# Modules of the functions that show an object; they import the objects, so that they load late.
_HOMES = {
    "make_figure": "tactorch.viz.figures",
    "make_html": "tactorch.viz.figures",
    "to_pyvista": "tactorch.viz.solid",
    "show": "tactorch.viz.solid",
    "report_of": "tactorch.report",
    "summarize": "tactorch.inverse.result.text",
}


def view(name: str, *given: Any, **options: Any) -> Any:
    """Call a function that shows an object."""
    return getattr(import_module(_HOMES[name]), name)(*given, **options)


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
        figure: Figure = view("make_figure", self, **options)
        return figure

    def to_pyvista(self) -> "pyvista.DataObject":
        """Return the object for PyVista, lengths in mm; see `tactorch.viz.solid`.

        Raises:
            ConfigError: PyVista is not installed.
        """
        return view("to_pyvista", self)

    def show(self, *, screenshot: str | Path | None = None, **options: Any) -> None:
        """Show the object in three dimensions with PyVista.

        Args:
            screenshot: File for a picture instead of a window, such as `view.png`.
            options: Options of `pyvista.Plotter.show`, such as `jupyter_backend="static"`.

        Raises:
            ConfigError: PyVista is not installed, or there is no window system, notebook or file.
        """
        view("show", self, screenshot, **options)

    def _repr_html_(self) -> str:
        """Return the summary and the figure for a notebook."""
        text: str = view("make_html", self)
        return text

"""Tables for people: drawn at a terminal, aligned text without control codes elsewhere."""

import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from tactorch.text import printable

_GAP = "  "
_NO_CONTROL = ("", "dumb", "unknown")  # TERM of terminals that know no control codes


@dataclass(frozen=True)
class Table:
    """Cells with a header.

    Attributes:
        header: Name of each column.
        rows: Cells of each row.
        words: Columns from the left that hold words; the others hold numbers, set to the right.
        styles: Rich's styles of cells that hold just this text, at a terminal.
    """

    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    words: int = 1
    styles: Mapping[str, str] = field(default_factory=dict)

    def text(self) -> str:
        """Return aligned lines, whatever their length: nothing is wrapped or cut."""
        rows = [[printable(cell) for cell in row] for row in self.rows]
        lines = [self.header, *rows] if any(self.header) else rows
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        return "\n".join(
            _GAP.join(self._set(k, cell, widths[k]) for k, cell in enumerate(line)).rstrip()
            for line in lines
        )

    def _set(self, column: int, cell: str, width: int) -> str:
        return cell.ljust(width) if column < self.words else cell.rjust(width)


def is_rich(stream: Any = None) -> bool:
    """Whether a stream (standard output, if none is given) is a terminal that can be drawn on."""
    try:
        is_terminal = (sys.stdout if stream is None else stream).isatty()
    except (AttributeError, ValueError):  # none at all, or closed
        return False
    return is_terminal and os.environ.get("TERM", "") not in _NO_CONTROL


def show(table: Table) -> None:
    """Print a table."""
    try:
        if is_rich():
            draw(table)
            return
    except ImportError:  # `tactorch doctor` is run just where packages are missing
        pass
    print(table.text())


def draw(table: Table) -> None:
    """Draw a table at the terminal.

    Raises:
        ImportError: Rich is not installed.
    """
    from rich import box
    from rich.console import Console
    from rich.table import Table as Rich
    from rich.text import Text

    drawing = Rich(box=box.SIMPLE_HEAD, show_header=any(table.header), header_style="")
    for column, name in enumerate(table.header):
        side: Literal["left", "right"] = "left" if column < table.words else "right"
        drawing.add_column(Text(name), justify=side)
    for row in table.rows:
        drawing.add_row(*(Text(printable(cell), table.styles.get(cell, "")) for cell in row))
    Console(highlight=False).print(drawing)

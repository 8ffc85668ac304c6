"""Output of the commands: messages, tables and progress, at a terminal and in the log file.

At a terminal tables and progress are drawn by Rich; elsewhere they are plain text without control
codes.
"""

import io
import logging
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol, runtime_checkable

from tactorch.errors import FileError
from tactorch.progress import is_terminal, progress_line, without_progress
from tactorch.text import printable

#: Exit statuses other than 0: of wrong input, and of Ctrl-C.
WRONG, INTERRUPTED = 2, 130
_NO_CONTROL = ("", "dumb", "unknown")  # TERM of terminals that know no control codes
_STEPS = ("tactorch.inverse.fit.monitor", "tactorch.inverse.search")  # loggers
_LINES = 10  # of progress in a log

log = logging.getLogger("tactorch")


@dataclass(frozen=True)
class Table:
    """Cells with a header."""

    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    words: int = 1  # number of columns, from the left, of words; numbers are set to the right
    styles: Mapping[str, str] = field(default_factory=dict)  # Rich's style of cells by their text

    def text(self) -> str:
        """Return aligned lines, whatever their length: nothing is wrapped or cut."""
        rows = [[printable(cell) for cell in row] for row in self.rows]
        lines = [self.header, *rows] if any(self.header) else rows
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        sides = ["<" if column < self.words else ">" for column in range(len(widths))]
        formats = [f"{{:{side}{width}}}" for side, width in zip(sides, widths, strict=True)]
        return "\n".join("  ".join(formats).format(*line).rstrip() for line in lines)

    def draw(self) -> None:
        """Draw the table at the terminal."""
        from rich import box
        from rich.console import Console
        from rich.table import Table as RichTable
        from rich.text import Text

        drawing = RichTable(box=box.SIMPLE_HEAD, show_header=any(self.header), header_style="")
        for column, name in enumerate(self.header):
            side: Literal["left", "right"] = "left" if column < self.words else "right"
            drawing.add_column(Text(name), justify=side)
        for row in self.rows:
            drawing.add_row(*(Text(printable(cell), self.styles.get(cell, "")) for cell in row))
        Console(highlight=False).print(drawing)


def is_rich(stream: Any = None) -> bool:
    """Return whether a stream (by default standard output) is a terminal that can be drawn on."""
    return is_terminal(stream or sys.stdout) and os.environ.get("TERM", "") not in _NO_CONTROL


def show(table: Table) -> None:
    """Print a table."""
    with suppress(ImportError):  # `tactorch doctor` is run just where packages are missing
        if is_rich():
            table.draw()
            return
    print(table.text())


def log_text(*parts: str | Table) -> None:
    """Log text and tables, one below the other; tables are drawn at a terminal."""
    texts = [part.text() if isinstance(part, Table) else printable(part) for part in parts]
    if not is_rich():
        log.info("%s", "\n".join(texts))
        return
    to_log_file("\n".join(texts))
    for part, text in zip(parts, texts, strict=True):
        if isinstance(part, Table):
            part.draw()
        else:
            print(text)


@contextmanager
def terminal_log(is_shown: Callable[[logging.LogRecord], bool]) -> Iterator[None]:
    """Meanwhile print only some log records; the run's log file gets all of them."""
    handlers = [h for h in logging.getLogger().handlers if not isinstance(h, logging.FileHandler)]
    for handler in handlers:
        handler.addFilter(is_shown)
    try:
        yield
    finally:
        for handler in handlers:
            handler.removeFilter(is_shown)


def is_no_iteration(record: logging.LogRecord) -> bool:
    """Return whether a log record is other than a line about a step of an inversion."""
    return not record.name.startswith(_STEPS) or record.levelno > logging.INFO


def to_log_file(message: str, error: bool = False) -> None:
    """Write to the run's log file only; errors with their traceback."""
    level, trace = (logging.ERROR, sys.exc_info()) if error else (logging.INFO, None)
    record = logging.LogRecord("tactorch", level, "", 0, message, None, trace)
    for handler in logging.getLogger().handlers:
        if isinstance(handler, logging.FileHandler):
            handler.handle(record)


class _WholeWrites(io.FileIO):
    """Unbuffered file. A disk that takes a part of a record raises an error."""

    def write(self, data: Any) -> int:
        rest = memoryview(data)
        while rest:
            rest = rest[super().write(rest) :]
        return len(data)


class RunLog(logging.FileHandler):
    """Log file of a run. A command fails where the file cannot be written, as on a full disk."""

    _failed = False

    def _open(self) -> Any:
        # Unbuffered: a buffer would be written again when the process ends.
        file: Any = _WholeWrites(self.baseFilename, self.mode)
        return io.TextIOWrapper(file, self.encoding, self.errors, write_through=True)

    def handleError(self, record: logging.LogRecord) -> None:
        """Raise the first error of the file; further messages are dropped."""
        error = sys.exc_info()[1]
        if not isinstance(error, OSError):
            super().handleError(record)
        elif not self._failed:
            self._failed = True
            raise FileError(
                f"cannot write '{self.baseFilename}': {error}; check the folder, its permissions "
                "and the free space, or choose another run_dir."
            ) from error


@runtime_checkable
class ProgressCallback(Protocol):
    """Receives the progress of a computation."""

    def __call__(self, done: int, total: int, note: str = "") -> None:
        """Report the number of items that are done, the total, and a note such as ", 2 failed"."""


@contextmanager
def progress(label: str, items: str) -> Iterator[ProgressCallback]:
    """Show the progress of a computation: a bar at a terminal, else some lines in the log."""
    if is_rich(sys.stderr):
        with without_progress(), _bar(label, items) as update:
            yield update
    else:
        with progress_line(label) as show:
            yield _log_progress(label, items, show)


@contextmanager
def _bar(label: str, items: str) -> Iterator[ProgressCallback]:
    from rich import progress as rich
    from rich.console import Console

    counts = (rich.MofNCompleteColumn(), items + "{task.fields[note]}")
    times = (rich.TimeElapsedColumn(), "left", rich.TimeRemainingColumn())
    columns = ("{task.description}", rich.BarColumn(), *counts, *times)
    console = Console(stderr=True)
    with rich.Progress(*columns, console=console, speed_estimate_period=3600.0) as bar:
        task = bar.add_task(label, total=None, note="")

        def update(done: int, total: int, note: str = "") -> None:
            bar.update(task, completed=done, total=total, note=note)

        yield update


def _log_progress(label: str, items: str, show: Callable[[str], None]) -> ProgressCallback:
    """Return a function that shows the progress, and logs it when another tenth is done."""
    last_part, done_before, start = 0, -1, 0.0

    def update(done: int, total: int, note: str = "") -> None:
        nonlocal last_part, done_before, start
        if done_before < 0:  # an earlier run may have done some
            done_before, start = done, time.monotonic()
        part = _LINES * done // max(total, 1)
        left = (time.monotonic() - start) * (total - done) / max(done - done_before, 1)
        rest = f", about {left:.0f} s left" if done_before < done < total and left >= 1 else ""
        state = f"{done} of {total} {items}{note}{rest}"
        if part > last_part:
            last_part = part
            log.info("%s: %s", label, state)
        show(state)

    return update

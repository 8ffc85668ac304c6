"""How far a long piece of work is: a bar at a terminal, else some lines in the log."""

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol, runtime_checkable

from tactorch.cli.logs import log
from tactorch.cli.tables import is_rich

_LINES = 10  # of progress in a log


@runtime_checkable
class ProgressCallback(Protocol):
    """Says how far it is."""

    def __call__(self, done: int, total: int, note: str = "") -> None:
        """Tell what is done, of how many, and what else there is to say, as ", 2 failed"."""


@contextmanager
def progress(label: str, what: str) -> Iterator[ProgressCallback]:
    """Give a function to call with what is done and the total.

    Args:
        label: What is going on.
        what: The things that are counted.
    """
    if not is_rich(sys.stderr):
        yield _in_lines(label, what)
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn(what + "{task.fields[note]}"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), speed_estimate_period=3600.0) as bar:
        task = bar.add_task(label, total=None, note="")

        def tell(done: int, total: int, note: str = "") -> None:
            bar.update(task, completed=done, total=total, note=note)

        yield tell


def _in_lines(label: str, what: str) -> ProgressCallback:
    shown, begun, start = 0, -1, 0.0

    def tell(done: int, total: int, note: str = "") -> None:
        nonlocal shown, begun, start
        if begun < 0:  # perhaps what a run before this one did
            begun, start = done, time.monotonic()
        part = _LINES * done // max(total, 1)
        if part <= shown:
            return
        shown = part
        left = (time.monotonic() - start) * (total - done) / max(done - begun, 1)
        rest = f", about {left:.0f} s left" if begun < done < total and left >= 1 else ""
        log.info("%s: %d of %d %s%s%s", label, done, total, what, note, rest)

    return tell

"""How far a long piece of work is: a bar at a terminal, else some lines in the log."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from tactorch.cli.settings import log

Tell = Callable[[int, int], None]
_LINES = 10  # of progress in a log


@contextmanager
def progress(label: str, what: str) -> Iterator[Tell]:
    """Give a function to call with what is done and the total.

    Args:
        label: What is going on.
        what: The things that are counted.
    """
    if not sys.stderr.isatty():
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
        TextColumn(what),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), speed_estimate_period=3600.0) as bar:
        task = bar.add_task(label, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def _in_lines(label: str, what: str) -> Tell:
    shown, start = 0, time.monotonic()

    def tell(done: int, total: int) -> None:
        nonlocal shown
        part = _LINES * done // max(total, 1)
        if part <= shown:
            return
        shown = part
        left = (time.monotonic() - start) * (total - done) / max(done, 1)
        rest = f", about {left:.0f} s left" if done < total else ""
        log.info("%s: %d of %d %s%s", label, done, total, what, rest)

    return tell

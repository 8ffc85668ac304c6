"""A progress line for people at a terminal; the log has the same per iteration."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def progress(label: str, show: bool | None = None) -> Iterator[Callable[[dict[str, Any]], None]]:
    """Show iteration, misfit and step while an optimizer runs.

    Args:
        label: What runs.
        show: Whether to show it; by default only where standard error is a terminal.

    Yields:
        A function to call with each record of the history.
    """
    if not (sys.stderr.isatty() if show is None else show):
        yield lambda record: None
        return
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}  iteration {task.completed}"),
        TextColumn("{task.fields[state]}"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(label, total=None, state="first equilibrium")

        def update(record: dict[str, Any]) -> None:
            state = f"misfit {record['misfit']:.3e} mm2  step {record.get('step', 0.0):.2g}"
            bar.update(task, completed=record["iteration"], state=state)

        yield update

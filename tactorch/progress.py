"""Progress of long computations: a line at a terminal or in a notebook, else one now and then.

A long computation gives a sign of life every ten seconds, whatever it does.

A computation inside another one is shown as its state. Computations in other threads, and inside
one that is not shown, are not shown.
"""

import html
import logging
import math
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeAlias

_log = logging.getLogger("tactorch")
_BRIEF_S = 1.0  # computations that are not kept on the screen
_PERIOD_S = 0.2  # between updates in a notebook
_PLAIN_PERIOD_S = 8.0  # between lines that are kept
_PAUSE_S = 5.0  # between computations that follow each other without a sign of life
_TICK_S = 1.0

Update: TypeAlias = Callable[[str], None]


@contextmanager
def progress_line(label: str, show: bool | None = None) -> Iterator[Update]:
    """Show a computation while it runs.

    Args:
        label: Name of the computation.
        show: Whether it is shown; by default at a terminal, in a notebook, and elsewhere by a line
            where nothing was logged for eight seconds.

    Yields:
        A function to call with the state of the computation, as text.
    """
    if threading.current_thread() is not threading.main_thread():
        yield _ignore
    elif show is None and _running:
        with _inside(_running[-1], label) as update:
            yield update
    else:
        with _outermost(label, show) as update:
            yield update


@contextmanager
def without_progress() -> Iterator[None]:
    """Show no computation meanwhile."""
    with progress_line("", show=False):
        yield


@contextmanager
def noted(text: str) -> Iterator[None]:
    """Show text as the state of the computation that runs, in whatever thread it is."""
    with _inside(_running[-1] if _running else None, text):
        yield


class _Computation:
    """A computation that is shown, with its state."""

    def __init__(self, label: str, line: "_TerminalLine | _PlainLine") -> None:
        self._label, self._line = label, line
        self.state = ""
        self.update("")

    def update(self, state: str) -> None:
        self.state = state
        self._line.show(f"{self._label}: {state}" if state else self._label)


# Computations of the main thread, each inside the one before; None for one that is not shown.
_running: list[_Computation | None] = []


@contextmanager
def _inside(outer: _Computation | None, label: str) -> Iterator[Update]:
    """Show a computation as the state of another one."""
    if outer is None:
        yield _ignore
        return
    before = outer.state
    prefix = f"{before}, {label}" if before else label
    outer.update(prefix)
    try:
        yield lambda state: outer.update(f"{prefix}, {state}")
    finally:
        outer.update(before)


@contextmanager
def _outermost(label: str, show: bool | None) -> Iterator[Update]:
    line = None if show is False else _new_line(forced=show is True)
    computation = None if line is None else _Computation(label, line)
    _running.append(computation)
    start = time.monotonic()
    try:
        yield _ignore if computation is None else computation.update
    finally:
        _running.pop()
        if line is not None:
            line.close(time.monotonic() - start)


def _new_line(forced: bool) -> "_TerminalLine | _PlainLine":
    if in_notebook():
        return _NotebookLine()
    if forced or is_terminal(sys.stderr):
        return _TerminalLine()
    return _LogLine() if _log.isEnabledFor(logging.INFO) else _PlainLine()


def in_notebook() -> bool:
    """Return whether this is a kernel of Jupyter."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    return getattr(shell, "kernel", None) is not None


def is_terminal(stream: Any) -> bool:
    """Return whether a stream is a terminal."""
    try:
        return bool(stream.isatty())
    except (AttributeError, ValueError):  # none at all, or closed
        return False


def _ignore(state: str) -> None:
    pass


class _TerminalLine:
    """A line with a spinner and the elapsed time at a terminal."""

    def __init__(self) -> None:
        from rich.console import Console
        from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

        text = TextColumn("{task.description}", markup=False)
        self._bar = Progress(
            SpinnerColumn(), text, TimeElapsedColumn(), console=Console(stderr=True)
        )
        self._task = self._bar.add_task("", total=None)
        self._bar.start()

    def show(self, text: str) -> None:
        self._bar.update(self._task, description=text)

    def close(self, seconds: float) -> None:
        self._bar.live.transient = seconds < _BRIEF_S
        self._bar.stop()


class Silence:
    """Since when there was no sign of life, and until when there was a computation, s."""

    since, until = 0.0, -math.inf

    @classmethod
    def end(cls, last_sign: float) -> None:
        """Note the end of a computation and its last sign of life, of `time.monotonic`."""
        cls.since, cls.until = last_sign, time.monotonic()


class _PlainLine:
    """Lines with seconds between them, written by another thread: the state may not change."""

    period_s = _PLAIN_PERIOD_S

    def __init__(self) -> None:
        self._start = self._last = time.monotonic()
        if self._start - Silence.until < _PAUSE_S:
            brief = max(self.period_s - _BRIEF_S, 0.0)
            self._last = max(Silence.since, self._start - brief)
        self._text, self._ended = "", threading.Event()
        threading.Thread(target=self._repeat, daemon=True).start()

    def show(self, text: str) -> None:
        self._text = text
        self.write_when_due()

    def write_when_due(self) -> None:
        """Write the state, if nothing was written for a while."""
        now = time.monotonic()
        if now - self._last >= self.period_s:
            self._last = now
            self._write(f"{self._text} ({now - self._start:.0f} s)")

    def close(self, seconds: float) -> None:
        self._ended.set()
        Silence.end(self._last)

    def _write(self, line: str) -> None:
        print(line, file=sys.stderr, flush=True)

    def _repeat(self) -> None:
        while not self._ended.wait(_TICK_S):
            self.write_when_due()


class _NotebookLine(_PlainLine):
    """A line of a notebook's output that is replaced, without widgets."""

    period_s = _PERIOD_S

    def __init__(self) -> None:
        self._handle: Any = None
        super().__init__()
        self._last -= self.period_s

    def close(self, seconds: float) -> None:
        super().close(seconds)
        self._write("" if seconds < _BRIEF_S else f"{self._text} ({seconds:.1f} s)")

    def _write(self, line: str) -> None:
        from IPython.display import HTML, display

        shown = HTML(f"<pre>{html.escape(line)}</pre>" if line else "")
        if self._handle is None:
            self._handle = display(shown, display_id=True)
        else:
            self._handle.update(shown)


class _LogLine(_PlainLine, logging.Handler):
    """Such lines in the log, where no other message was logged meanwhile."""

    def __init__(self) -> None:
        logging.Handler.__init__(self)
        _PlainLine.__init__(self)
        _log.addHandler(self)

    def emit(self, record: logging.LogRecord) -> None:
        """Note the time of a message."""
        self._last = time.monotonic()

    def close(self, seconds: float = 0.0) -> None:
        _log.removeHandler(self)
        _PlainLine.close(self, seconds)
        logging.Handler.close(self)

    def _write(self, line: str) -> None:
        if _log.isEnabledFor(logging.INFO):
            _log.info("%s", line)
        else:  # meanwhile, as in a computation on one thread
            super()._write(line)

"""Lines until a command starts: its packages take seconds to import."""

import time
from collections.abc import Sequence
from contextlib import suppress
from threading import Event, Thread

#: Set when a command runs, and gives signs of life itself.
STARTED = Event()
_SOON_S, _PERIOD_S = 0.7, 8.0
# Of words whose output other programs read.
_TEXT = {"-h", "--help", "-c", "--cfg", "-i", "--info", "--hydra-help", "--version", "completion"}


def show_starting(words: Sequence[str]) -> None:
    """Print a line soon, and others until the command starts, from another thread."""
    if words and not _TEXT.intersection(words):
        Thread(target=_repeat, args=words[:1], daemon=True).start()


def _repeat(verb: str) -> None:
    wait_s, last = _SOON_S, time.monotonic()
    while not STARTED.wait(wait_s):
        with suppress(OSError, ValueError):  # no one reads it
            print(f"tactorch {verb}: working ...", flush=True)
        wait_s, last = _PERIOD_S, time.monotonic()
    from tactorch.progress import Silence  # loads logging, which the help does without

    Silence.end(last)

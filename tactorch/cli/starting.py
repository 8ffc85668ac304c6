"""Lines until a command starts: its packages take seconds to import."""

import sys
from threading import Event, Thread

#: Set when a command runs, and gives signs of life itself.
STARTED = Event()
_SOON_S, _PERIOD_S = 0.7, 8.0


def show_starting(verb: str) -> None:
    """Print a line soon, and others until the command starts, from another thread."""
    Thread(target=_repeat, args=(verb,), daemon=True).start()


def _repeat(verb: str) -> None:
    wait_s = _SOON_S
    while not STARTED.wait(wait_s):
        print(f"tactorch {verb}: working ...", file=sys.stderr, flush=True)
        wait_s = _PERIOD_S

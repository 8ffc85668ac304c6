"""Compilation of the kernels by Numba, as a state of the computation that waits for it."""

from contextlib import ExitStack

from numba.core import event

from tactorch.progress import noted


class _Announcer(event.Listener):
    """Shows that kernels are compiled; Numba compiles one at a time, with others inside it."""

    def __init__(self) -> None:
        self._depth, self._stack = 0, ExitStack()

    def on_start(self, event: event.Event) -> None:
        """Begin with the outermost kernel."""
        self._depth += 1
        if self._depth == 1:
            self._stack.enter_context(noted("compiling, which is kept for later runs"))

    def on_end(self, event: event.Event) -> None:
        """End with the outermost kernel."""
        self._depth -= 1
        if self._depth == 0:
            self._stack.close()


def announce_compilation() -> None:
    """Show compilations from now on."""
    event.register("numba:compile", _Announcer())

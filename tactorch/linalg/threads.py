"""How many threads the numerical libraries use inside one call."""

from collections.abc import Iterator
from contextlib import contextmanager

from tactorch.linalg import pardiso


@contextmanager
def single_threaded() -> Iterator[None]:
    """Keep MKL on one thread in the calling thread, so that presses run side by side."""
    if not pardiso.available():
        yield
        return
    previous = pardiso.set_local_threads(1)
    try:
        yield
    finally:
        pardiso.set_local_threads(previous)

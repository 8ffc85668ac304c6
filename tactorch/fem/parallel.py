"""Load cases side by side on the machine's cores."""

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeVar

from tactorch.linalg import single_threaded

T = TypeVar("T")
_limit: ContextVar[int | None] = ContextVar("tactorch_workers", default=None)


def worker_count() -> int:
    """Return how many threads may work side by side: the cores, or what `limit_workers` says."""
    return _limit.get() or os.cpu_count() or 1


@contextmanager
def limit_workers(count: int) -> Iterator[None]:
    """Let `map_cases` use at most `count` threads meanwhile, in the calling thread.

    For programs that already run one process per core.
    """
    token = _limit.set(max(1, count))
    try:
        yield
    finally:
        _limit.reset(token)


def map_cases(work: Callable[[int], T], count: int) -> list[T]:
    """Run `work(case)` for all cases in threads; kernels and solvers release the GIL."""
    workers = min(count, worker_count())
    if workers <= 1:
        return [work(i) for i in range(count)]

    def alone(i: int) -> T:
        with single_threaded():
            return work(i)

    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(alone, range(count)))

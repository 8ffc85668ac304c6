"""Independent load cases in threads, and the number of threads they use."""

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar, copy_context
from typing import TypeVar

T = TypeVar("T")
_max_workers: ContextVar[int | None] = ContextVar("tactorch_max_workers", default=None)


def worker_count() -> int:
    """Return the number of threads that `map_cases` uses: the cores, unless limited."""
    return _max_workers.get() or os.cpu_count() or 1


@contextmanager
def limit_workers(count: int) -> Iterator[None]:
    """Limit `map_cases` to `count` threads, in the calling thread and those it starts.

    For programs that already run one process per core.
    """
    token = _max_workers.set(max(1, count))
    try:
        yield
    finally:
        _max_workers.reset(token)


def map_cases(work: Callable[[int], T], count: int) -> list[T]:
    """Run `work(case)` for all cases in threads, and return the results in order.

    Kernels and solvers release the GIL. The threads inherit the caller's context. A call within a
    case shares the caller's threads: all nested calls together use `worker_count()` at most.
    """
    available = worker_count()
    workers = min(count, available)
    if workers <= 1:
        return list(map(work, range(count)))

    def run(i: int) -> T:
        with limit_workers(available // workers):
            return work(i)

    contexts = [copy_context() for _ in range(count)]
    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(lambda i: contexts[i].run(run, i), range(count)))

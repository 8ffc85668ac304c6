"""Independent load cases in threads, and the number of threads they use."""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar, copy_context
from typing import TypeVar

from tactorch.linalg import pardiso

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


@contextmanager
def single_threaded() -> Iterator[None]:
    """Keep MKL on one thread in the calling thread, so that load cases run in parallel."""
    if not pardiso.Pardiso.available():
        yield
        return
    previous = pardiso.set_local_threads(1)
    try:
        yield
    finally:
        pardiso.set_local_threads(previous)


def map_cases(work: Callable[[int], T], count: int) -> list[T]:
    """Run `work(case)` for all cases in threads, and return the results in order.

    Kernels and solvers release the GIL. The threads inherit the caller's context. A call within a
    case shares the caller's threads: all nested calls together use `worker_count()` at most.
    """
    chains = map_chains(lambda case, _step, _before: work(case), [1] * count)
    return [result for (result,) in chains]


def map_chains(work: Callable[[int, int, T | None], T], lengths: Sequence[int]) -> list[list[T]]:
    """Run chains of load cases in threads, each case with the result of the one before it.

    The first cases of all chains run before the second ones, and so on. Threads are those of
    `map_cases`.

    Args:
        work: Called with the chain, the step in it, and the result of the step before (None at
            first).
        lengths: Number of steps of each chain.

    Returns:
        The results of each chain.
    """
    available = worker_count()
    workers = min(len(lengths), available)
    steps = sorted((step, chain) for chain, length in enumerate(lengths) for step in range(length))
    if workers <= 1:
        results: dict[tuple[int, int], T] = {}
        for chain, length in enumerate(lengths):
            for step in range(length):
                results[chain, step] = work(chain, step, results.get((chain, step - 1)))
        return _by_chain(results, lengths)
    futures: dict[tuple[int, int], Future[T]] = {}

    def run(chain: int, step: int) -> T:
        # Cases start in the order of their submission: the one before runs or has ended.
        before = futures[chain, step - 1].result() if step else None
        with single_threaded(), limit_workers(available // workers):
            return work(chain, step, before)

    with ThreadPoolExecutor(workers) as pool:
        for step, chain in steps:
            futures[chain, step] = pool.submit(copy_context().run, run, chain, step)
        try:
            results = {case: future.result() for case, future in futures.items()}
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return _by_chain(results, lengths)


def _by_chain(results: dict[tuple[int, int], T], lengths: Sequence[int]) -> list[list[T]]:
    return [
        [results[chain, step] for step in range(length)] for chain, length in enumerate(lengths)
    ]

"""Load cases side by side on the machine's cores."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from tactorch.linalg import single_threaded

T = TypeVar("T")


def map_cases(work: Callable[[int], T], count: int) -> list[T]:
    """Run `work(case)` for all cases in threads; kernels and solvers release the GIL."""
    workers = min(count, os.cpu_count() or 1)
    if workers <= 1:
        return [work(i) for i in range(count)]

    def alone(i: int) -> T:
        with single_threaded():
            return work(i)

    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(alone, range(count)))

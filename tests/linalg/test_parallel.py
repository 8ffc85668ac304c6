"""Threads of load cases: how many there are, and what they inherit."""

import threading
from contextvars import ContextVar

import pytest

from tactorch.linalg import limit_workers, map_cases, parallel
from tactorch.linalg.parallel import worker_count


@pytest.fixture(autouse=True)
def four_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parallel.os, "cpu_count", lambda: 4)
    monkeypatch.setattr(parallel, "_max_workers", ContextVar("no limit of the tests", default=None))


def peak_of_nested_calls(outer: int, inner: int) -> int:
    """Return the largest number of cases that ran at once."""
    lock, running, peak = threading.Lock(), 0, 0
    pause = threading.Event()

    def leaf(_: int) -> None:
        nonlocal running, peak
        with lock:
            running += 1
            peak = max(peak, running)
        pause.wait(0.02)
        with lock:
            running -= 1

    map_cases(lambda _: map_cases(leaf, inner), outer)
    return peak


@pytest.mark.parametrize(("outer", "inner"), [(4, 4), (2, 8), (8, 2), (3, 5)])
def test_nested_calls_use_no_more_threads_than_there_are_cores(outer: int, inner: int) -> None:
    assert peak_of_nested_calls(outer, inner) <= 4


def test_nested_calls_use_what_the_outer_one_leaves() -> None:
    assert map_cases(lambda _: worker_count(), 2) == [2, 2]
    assert map_cases(lambda _: worker_count(), 4) == [1] * 4


def test_threads_inherit_the_limit_and_the_context() -> None:
    name: ContextVar[str] = ContextVar("name", default="nobody")
    token = name.set("caller")
    with limit_workers(2):
        assert map_cases(lambda _: name.get(), 3) == ["caller"] * 3
        assert map_cases(lambda _: worker_count(), 3) == [1] * 3
    name.reset(token)
    assert worker_count() == 4


def test_results_come_in_the_order_of_the_cases() -> None:
    assert map_cases(lambda i: i * i, 20) == [i * i for i in range(20)]

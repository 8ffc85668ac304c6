"""Threads of load cases: how many there are, and what they inherit."""

import threading
from contextvars import ContextVar

import pytest

from tactorch.linalg import limit_workers, map_cases, map_chains, parallel
from tactorch.linalg.parallel import worker_count


@pytest.fixture(autouse=True)
def four_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parallel.os, "cpu_count", lambda: 4)


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


@pytest.mark.parametrize("workers", [1, 2, 8])
def test_each_case_of_a_chain_has_the_result_of_the_one_before(workers: int) -> None:
    def work(chain: int, step: int, before: list[int] | None) -> list[int]:
        return [*(before or [10 * chain]), step]

    with limit_workers(workers):
        chains = map_chains(work, [3, 0, 1, 2, 2])
    assert [len(chain) for chain in chains] == [3, 0, 1, 2, 2]
    assert chains[0] == [[0, 0], [0, 0, 1], [0, 0, 1, 2]]
    assert chains[4] == [[40, 0], [40, 0, 1]]


def test_chains_share_the_threads_evenly() -> None:
    """Three chains of two cases take three times as long as a case with two threads, not four."""
    lock, done = threading.Lock(), list[tuple[int, int]]()
    together = threading.Barrier(2, timeout=5.0)

    def work(chain: int, step: int, before: None) -> None:
        together.wait()
        with lock:
            done.append((chain, step))

    with limit_workers(2):
        map_chains(work, [2, 2, 2])  # a thread that were left alone would break the barrier
    assert sorted(done) == [(chain, step) for chain in range(3) for step in range(2)]


def test_an_error_in_a_chain_ends_the_others() -> None:
    started = list[tuple[int, int]]()

    def work(chain: int, step: int, before: None) -> None:
        started.append((chain, step))
        raise ValueError(f"chain {chain} at step {step}")

    with limit_workers(2), pytest.raises(ValueError, match="chain 0 at step 0"):
        map_chains(work, [5] * 20)
    assert all(step == 0 for _, step in started)

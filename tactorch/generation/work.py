"""Making samples side by side: on this machine's cores, or on a Dask cluster."""

import logging
import os
import warnings
from collections.abc import Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager
from threading import Lock
from typing import Any

from tactorch.errors import ConfigError, TactorchError
from tactorch.generation.layout import to_bytes
from tactorch.generation.recipe import Recipe
from tactorch.generation.sample import make_sample

EXECUTORS = ("processes", "dask")
_ONE_AT_A_TIME = Lock()
_KILLED = (
    "A worker process was killed, most likely for want of memory; give fewer workers. What is done"
    " is kept: the same command goes on."
)
#: A sample's number, its content, and why there is none.
Outcome = tuple[int, bytes | None, str]


def outcomes(
    recipe: Recipe,
    indices: Sequence[int],
    executor: str = "processes",
    workers: int | None = None,
    scheduler: str | None = None,
) -> Iterator[Outcome]:
    """Make samples and yield each as it is done, in whatever order.

    Args:
        recipe: What to make.
        indices: Numbers of the samples.
        executor: "processes" on this machine, or "dask".
        workers: Processes; as many as there are cores by default.
        scheduler: Address of the Dask scheduler.

    Raises:
        ConfigError: The executor is unknown, or Dask is not installed or not there.
    """
    check_executor(executor, scheduler)
    if executor == "dask":
        yield from _on_dask(recipe, indices, scheduler)
    else:
        yield from _in_processes(recipe, indices, workers or os.cpu_count() or 1)


def check_executor(executor: str, scheduler: str | None) -> None:
    """Refuse an executor that is unknown, or that lacks its scheduler.

    Raises:
        ConfigError: It is.
    """
    if executor not in EXECUTORS:
        raise ConfigError(f"executor={executor!r}: choose one of {', '.join(EXECUTORS)}.")
    if executor == "dask" and scheduler is None:
        raise ConfigError(
            "executor=dask needs scheduler=ADDRESS, such as tcp://127.0.0.1:8786; start one with"
            " `dask scheduler`, and workers with `dask worker ADDRESS --nthreads 1`."
        )


def work(recipe: Recipe, index: int) -> Outcome:
    """Make one sample; what goes wrong with it is its outcome."""
    try:
        # A cluster may run several tasks in one process, whose thread counts are common to all.
        with _ONE_AT_A_TIME, alone():
            return index, to_bytes(make_sample(recipe, index)), ""
    except Exception as error:  # one bad sample must not end the rest
        return index, None, f"{type(error).__name__}: {' '.join(str(error).split())}"


@contextmanager
def alone() -> Iterator[None]:
    """Keep every library to one thread, so that results do not depend on how many there are.

    And keep the iterations of each sample out of the log.
    """
    import numba
    import torch
    from threadpoolctl import threadpool_limits

    from tactorch.linalg import limit_workers, single_threaded

    threads, compiled = torch.get_num_threads(), numba.get_num_threads()
    with ExitStack() as stack:
        stack.callback(logging.disable, logging.root.manager.disable)
        logging.disable(logging.INFO)
        stack.callback(torch.set_num_threads, threads)
        stack.callback(numba.set_num_threads, compiled)
        torch.set_num_threads(1)
        numba.set_num_threads(1)
        stack.enter_context(threadpool_limits(1))
        stack.enter_context(single_threaded())
        stack.enter_context(limit_workers(1))
        yield


def _in_processes(recipe: Recipe, indices: Sequence[int], workers: int) -> Iterator[Outcome]:
    from joblib import Parallel, delayed, parallel_config

    with parallel_config(backend="loky", inner_max_num_threads=1), warnings.catch_warnings():
        # An interruption need not be told twice.
        warnings.filterwarnings("ignore", message=".*have been cancelled")
        pool = Parallel(n_jobs=min(workers, len(indices)), return_as="generator_unordered")
        try:
            yield from pool(delayed(work)(recipe, index) for index in indices)
        except BrokenProcessPool as error:
            raise TactorchError(_KILLED) from error


def _on_dask(recipe: Recipe, indices: Sequence[int], scheduler: str | None) -> Iterator[Outcome]:
    client = _client(scheduler)
    try:
        from distributed import as_completed

        if not client.scheduler_info()["workers"]:
            raise ConfigError(
                f"The Dask scheduler at {scheduler} has no workers; start some with `dask worker"
                f" {scheduler} --nthreads 1`."
            )
        shared = client.scatter(recipe, broadcast=True)
        futures = client.map(lambda i, r: work(r, i), indices, r=shared, pure=False)
        for future in as_completed(futures):
            yield future.result()
            future.release()
    finally:
        client.close()


def _client(scheduler: str | None) -> Any:
    try:
        from distributed import Client
    except ImportError as error:
        raise ConfigError(
            "executor=dask needs Dask: pip install 'tactorch[dask]' or 'dask[distributed]'."
        ) from error
    try:
        return Client(scheduler, timeout="10s")
    except (OSError, TimeoutError, ValueError) as error:
        raise ConfigError(
            f"No Dask scheduler answers at {scheduler} ({error}); check the address, and that"
            " `dask scheduler` runs there."
        ) from error

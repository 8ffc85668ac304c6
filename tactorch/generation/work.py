"""Making samples side by side: on this machine's cores, or on a Dask cluster."""

from collections.abc import Iterator, Sequence
from functools import partial
from threading import Lock
from typing import Any

from tactorch.errors import ConfigError
from tactorch.generation.layout import to_bytes
from tactorch.generation.recipe import Recipe
from tactorch.generation.sample import make_sample
from tactorch.processes import run_in_processes, single_thread

EXECUTORS = ("processes", "dask")
_ONE_AT_A_TIME = Lock()
#: A sample's number, its content, and why there is none.
Outcome = tuple[int, bytes | None, str]


def outcomes(
    recipe: Recipe,
    indices: Sequence[int],
    executor: str = "processes",
    workers: int | None = None,
    scheduler: str | None = None,
) -> Iterator[Outcome]:
    """Make samples and yield each as it is finished, in any order.

    Args:
        recipe: Recipe of the samples.
        indices: Numbers of the samples to make.
        executor: "processes" on this machine, or "dask".
        workers: Number of processes; None for the number of cores.
        scheduler: Address of the Dask scheduler.

    Raises:
        ConfigError: The executor is unknown, or Dask is not installed or not there.
    """
    check_executor(executor, scheduler)
    if executor == "dask":
        yield from _on_dask(recipe, indices, scheduler)
    else:
        yield from run_in_processes(partial(work, recipe), indices, workers)


def check_executor(executor: str, scheduler: str | None) -> None:
    """Check the executor and its scheduler.

    Raises:
        ConfigError: The executor is unknown, or lacks its scheduler.
    """
    if executor not in EXECUTORS:
        raise ConfigError(f"executor={executor!r}: choose one of {', '.join(EXECUTORS)}.")
    if executor == "dask" and scheduler is None:
        raise ConfigError(
            "executor=dask needs scheduler=ADDRESS, such as tcp://127.0.0.1:8786; start one with"
            " `dask scheduler`, and workers with `dask worker ADDRESS --nthreads 1`."
        )


def work(recipe: Recipe, index: int) -> Outcome:
    """Make one sample, or return the reason of its failure."""
    try:
        # A cluster may run several tasks in one process, whose thread counts are common to all.
        with _ONE_AT_A_TIME, single_thread():
            return index, to_bytes(make_sample(recipe, index)), ""
    except Exception as error:  # one bad sample must not end the rest
        return index, None, f"{type(error).__name__}: {' '.join(str(error).split())}"


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

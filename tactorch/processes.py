"""Independent tasks in worker processes of one thread each."""

import logging
import os
import signal
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager
from typing import TypeVar

from tactorch.errors import TactorchError
from tactorch.progress import without_progress

Task = TypeVar("Task")
Result = TypeVar("Result")


def run_in_processes(
    function: Callable[[Task], Result], tasks: Sequence[Task], workers: int | None = None
) -> Iterator[Result]:
    """Call a function for each task and yield its results in order of completion.

    The function must be picklable and should use `single_thread`. By default there are as many
    processes as cores.
    """
    from joblib import Parallel, delayed, parallel_config

    count = min(workers or os.cpu_count() or 1, len(tasks) or 1)
    with parallel_config(backend="loky", inner_max_num_threads=1), warnings.catch_warnings():
        # An interrupted pool warns about the tasks that it cancels.
        warnings.filterwarnings("ignore", message=".*have been cancelled")
        pool = Parallel(n_jobs=count, return_as="generator_unordered")
        try:
            with _ctrl_c_ignored():
                results = pool(delayed(function)(task) for task in tasks)
            yield from results
        except BrokenProcessPool as error:
            raise TactorchError(
                "A worker process was killed, probably because memory is exhausted; give fewer"
                " workers. Finished results are kept: repeat the command to continue."
            ) from error


@contextmanager
def _ctrl_c_ignored() -> Iterator[None]:
    """Start processes that ignore Ctrl-C: the main process receives it too, and ends them.

    Otherwise one that is importing packages prints a traceback.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)  # processes that are started inherit it
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def single_thread() -> Iterator[None]:
    """Limit every library to one thread and silence informational log messages.

    Results then do not depend on the number of threads.
    """
    import numba
    import torch
    from threadpoolctl import threadpool_limits

    from tactorch.linalg import limit_workers

    threads, compiled = torch.get_num_threads(), numba.get_num_threads()
    with ExitStack() as stack:
        stack.enter_context(without_progress())
        stack.callback(logging.disable, logging.root.manager.disable)
        logging.disable(logging.INFO)
        stack.callback(torch.set_num_threads, threads)
        stack.callback(numba.set_num_threads, compiled)
        torch.set_num_threads(1)
        numba.set_num_threads(1)
        stack.enter_context(threadpool_limits(1))
        stack.enter_context(limit_workers(1))
        yield

"""Description of the machine of a benchmark, and the load by other processes."""

import json
import os
import platform
import resource
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from importlib.metadata import PackageNotFoundError, version
from multiprocessing import get_context
from pathlib import Path
from typing import Any, TypeVar

Item, Result = TypeVar("Item"), TypeVar("Result")


def describe_machine(packages: tuple[str, ...]) -> dict[str, str | int]:
    """Return the processor, its cores, the system, Python and the versions of `packages`."""
    return {
        "cpu": _processor(),
        "cores": os.cpu_count() or 1,
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        **{name: _version(name) for name in packages},
    }


def write_results(
    folder: Path, name: str, lines: list[str], result: dict[str, Any], packages: tuple[str, ...]
) -> None:
    """Write NAME.md with the lines, and NAME.json with the figures and the machine."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{name}.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    content = json.dumps({**result, "machine": describe_machine(packages)}, indent=1)
    (folder / f"{name}.json").write_text(content + "\n", encoding="utf-8")


def peak_gib() -> float:
    """Largest resident memory of this process so far, GiB."""
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most / 2.0 ** (30 if sys.platform == "darwin" else 20)


def _processor() -> str:
    """Model of the processor and its instruction sets' highest vector width."""
    info = Path("/proc/cpuinfo")
    if not info.exists():
        return platform.processor() or platform.machine()
    fields: dict[str, str] = {}
    for line in info.read_text().splitlines():
        key, _, value = line.partition(":")
        fields.setdefault(key.strip(), value.strip())
    name = fields.get("model name", platform.machine())
    vectors = "AVX-512" if "avx512f" in fields.get("flags", "") else "no AVX-512"
    numbers = f"family {fields.get('cpu family', '?')} model {fields.get('model', '?')}"
    return f"{name} ({numbers}, {vectors}, {float(fields.get('cpu MHz', 0)) / 1e3:.1f} GHz)"


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def map_in_processes(
    work: Callable[[Item], Result], items: Sequence[Item], workers: int
) -> Iterator[Result]:
    """Yield the results of the items in order; with more than one worker from parallel processes.

    Each process has one thread: processes that share cores hinder one another's threads.
    """
    if workers == 1:
        yield from map(work, items)
        return
    os.environ.update(OMP_NUM_THREADS="1", MKL_NUM_THREADS="1", NUMBA_NUM_THREADS="1")
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        try:
            yield from pool.map(work, items)
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


class OtherWork:
    """Meter of the processor time of other processes, from its construction on.

    Processes that this one started count as its own once they have ended.
    """

    def __init__(self) -> None:
        """Start."""
        self._began = time.perf_counter(), _busy_seconds(), _stolen_seconds(), _own_seconds()

    def share(self) -> float | None:
        """Return the share of all cores that other processes used; None where unknown."""
        _, busy, _, own = self._began
        now = _busy_seconds()
        if busy is None or now is None:
            return None
        return self._of_cores((now - busy) - (_own_seconds() - own))

    def stolen(self) -> float | None:
        """Share of all cores that the host of this (virtual) machine gave to its other guests.

        None where unknown. A host may not report this to its guest; then it is 0.
        """
        before, now = self._began[2], _stolen_seconds()
        return None if before is None or now is None else self._of_cores(now - before)

    def _of_cores(self, seconds: float) -> float:
        """Share of what all cores could have done since the start."""
        available = (time.perf_counter() - self._began[0]) * (os.cpu_count() or 1)
        return max(seconds, 0.0) / available


def _own_seconds() -> float:
    """Processor seconds of this process and of those that it started and that have ended."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def _busy_seconds() -> float | None:
    """Processor seconds that all processes together have taken since the machine started."""
    spent = _spent_seconds()
    if spent is None:
        return None
    user, nice, system, _, _, interrupt, soft, _ = spent
    return user + nice + system + interrupt + soft


def _stolen_seconds() -> float | None:
    """Processor seconds that were wanted here and went to other guests of the host."""
    spent = _spent_seconds()
    return None if spent is None else spent[7]


def _spent_seconds() -> list[float] | None:
    """The first eight counts of Linux' /proc/stat, of all cores together, in seconds."""
    stat = Path("/proc/stat")
    if not stat.exists():
        return None
    counts = stat.read_text().split("\n", 1)[0].split()[1:9]
    return [int(count) / os.sysconf("SC_CLK_TCK") for count in counts]

"""Benchmarks in several processes: results in order, and whose processor time it is."""

import math
import os
import subprocess
import sys
from types import ModuleType

import pytest

NAME = "machine"


@pytest.mark.parametrize("workers", [1, 2])
def test_results_are_in_the_order_of_the_items(
    benchmark: ModuleType, workers: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    for variable in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
        monkeypatch.setenv(variable, os.environ.get(variable, "1"))
    found = benchmark.map_in_processes(math.sqrt, [4.0, 1.0, 9.0], workers)
    assert list(found) == [2.0, 1.0, 3.0]


def test_an_error_of_a_process_is_raised(
    benchmark: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    for variable in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
        monkeypatch.setenv(variable, os.environ.get(variable, "1"))
    with pytest.raises(ValueError, match="math domain"):
        list(benchmark.map_in_processes(math.sqrt, [1.0, -1.0], 2))


def test_processor_time_of_ended_processes_is_its_own(benchmark: ModuleType) -> None:
    before = benchmark._own_seconds()
    busy = "import os\nwhile sum(os.times()[:2]) < 0.5: pass"
    subprocess.run([sys.executable, "-c", busy], check=True)
    assert benchmark._own_seconds() - before > 0.4

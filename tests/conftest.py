"""What every test shares: the data folder, fixed seeds, no display, one thread per worker.

tactorch is not imported here: the jaxtyping hook of pytest must see its first import.
"""

import gc
import os
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
import shape_checks
import torch
from hypothesis import settings

ROOT = Path(__file__).resolve().parent.parent

os.environ.setdefault("MPLBACKEND", "Agg")

settings.register_profile("tactorch", deadline=None)
settings.register_profile("ci", deadline=None, derandomize=True, print_blob=True)
settings.load_profile("ci" if os.environ.get("CI") else "tactorch")

if "PYTEST_XDIST_WORKER" in os.environ:
    torch.set_num_threads(1)  # the workers already share the cores


class AtOnce:
    """Tells each failure as it comes: a run that is cut short never gets to its summary."""

    def __init__(self, config: pytest.Config) -> None:
        self.config = config

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        terminal = self.config.pluginmanager.get_plugin("terminalreporter")
        if report.failed and terminal is not None:
            terminal.write_line(f"\nFAILED {report.nodeid} ({report.when})\n{report.longreprtext}")


def pytest_configure(config: pytest.Config) -> None:
    if os.environ.get("CI") and not hasattr(config, "workerinput"):
        config.pluginmanager.register(AtOnce(config), "at-once")


@pytest.hookimpl(trylast=True)
def pytest_collection_finish() -> None:
    """Keep modules and tests, which stay to the end, out of each search for unused objects."""
    gc.collect()
    gc.freeze()


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup() -> None:
    shape_checks.restart()


@pytest.fixture(autouse=True)
def seed() -> int:
    """Make every test draw the same random numbers, alone or among others."""
    value = 20240607
    torch.manual_seed(value)
    np.random.seed(value)  # noqa: NPY002 - libraries under test may use the global state
    return value


@pytest.fixture(scope="session", autouse=True)
def one_thread_per_worker() -> Iterator[None]:
    """Solve load cases one after the other where other processes of the tests use the cores."""
    from tactorch.linalg import limit_workers

    with limit_workers(1) if "PYTEST_XDIST_WORKER" in os.environ else nullcontext():
        yield


@pytest.fixture(scope="session", autouse=True)
def cache_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Keep cached meshes of the tests out of the user's own cache."""
    folder = tmp_path_factory.mktemp("cache")
    os.environ["TACTORCH_CACHE"] = str(folder)
    return folder


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Return the folder of shared data sets, or skip the test and say why."""
    shared = Path(os.environ.get("TACTORCH_SHARED") or ROOT.parent / "shared")
    if not (shared / "data").is_dir():
        pytest.skip(f"no shared data: '{shared / 'data'}' is not a folder; set TACTORCH_SHARED")
    return shared / "data"

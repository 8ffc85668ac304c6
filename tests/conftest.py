"""What every test shares: the data folder, fixed seeds, no display, one thread per worker.

tactorch is not imported here: the jaxtyping hook of pytest must see its first import.
"""

import dataclasses
import functools
import inspect
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

import jaxtyping
import numpy as np
import pytest
import torch
from hypothesis import settings

ROOT = Path(__file__).resolve().parent.parent

os.environ.setdefault("MPLBACKEND", "Agg")

# Checks of shapes took two thirds of the tests' time: in an inversion small functions are called by
# the hundred thousand. Each is checked at its first calls, and at one of so many after those;
# TACTORCH_CHECK_EVERY=1 checks all.
CHECKED_FIRST, CHECK_EVERY = 40, int(os.environ.get("TACTORCH_CHECK_EVERY") or 25)


def _has_shapes(annotation: Any) -> bool:
    """Whether there are array shapes in it, or there may be: in a string."""
    if isinstance(annotation, str):
        return True
    if isinstance(annotation, (list, tuple)):
        return any(map(_has_shapes, annotation))
    if inspect.isclass(annotation) and issubclass(annotation, jaxtyping.AbstractArray):
        return True
    return any(map(_has_shapes, get_args(annotation)))


def _drawn(checker: Callable[..., Any], function: Callable[..., Any]) -> Callable[..., Any]:
    """Check some calls of a function."""
    checked, calls = checker(function), 0

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls <= CHECKED_FIRST or calls % CHECK_EVERY == 0:
            return checked(*args, **kwargs)
        return function(*args, **kwargs)

    return call


_all_checked = jaxtyping.jaxtyped


def _some_checked(*, typechecker: Any) -> Callable[[Any], Any]:
    """Stand in for `jaxtyping.jaxtyped`, where its hook decorates functions and classes."""

    def decorate(thing: Any) -> Any:
        if inspect.isclass(thing):
            settings = any(base.__module__ == "tactorch.config.options" for base in thing.__mro__)
            # Settings check and convert their values themselves.
            if dataclasses.is_dataclass(thing) and "__init__" in vars(thing) and not settings:
                thing.__init__ = decorate(thing.__init__)
            return thing
        if any(map(_has_shapes, getattr(thing, "__annotations__", {}).values())):
            return _drawn(_all_checked(typechecker=typechecker), thing)
        return typechecker(thing)

    return decorate


jaxtyping.jaxtyped = _some_checked

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


@pytest.fixture(autouse=True)
def seed() -> int:
    """Make every test draw the same random numbers, alone or among others."""
    value = 20240607
    torch.manual_seed(value)
    np.random.seed(value)  # noqa: NPY002 - libraries under test may use the global state
    return value


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

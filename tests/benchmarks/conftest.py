import importlib
import sys
from pathlib import Path
from types import ModuleType

import pytest

FOLDER = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture
def benchmark(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> ModuleType:
    """The benchmark script of the name that the test module's `NAME` says."""
    monkeypatch.syspath_prepend(str(FOLDER))
    name = request.module.NAME
    monkeypatch.delitem(sys.modules, name, raising=False)
    return importlib.import_module(name)

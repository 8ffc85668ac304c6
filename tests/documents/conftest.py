from collections.abc import Iterator
from pathlib import Path

import pytest

from tactorch.fem import MATERIALS


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty folder to be in; materials that a document adds are gone afterwards."""
    before = dict(MATERIALS._added)
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    MATERIALS._added = before

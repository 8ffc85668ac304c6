from collections.abc import Iterator
from pathlib import Path

import pytest

from tactorch.fem.materials import MATERIALS


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty folder to be in; materials that a document adds are gone afterwards."""
    before = dict(MATERIALS)
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    MATERIALS.clear()
    MATERIALS.update(before)

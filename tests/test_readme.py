"""The Python of the README runs as it stands."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

README = Path(__file__).resolve().parent.parent / "README.md"


def blocks() -> list[str]:
    found = re.findall(r"```python\n(.*?)```", README.read_text(), flags=re.DOTALL)
    return [block for block in found if "forces=forces" not in block]  # that one needs the user's


def test_the_readme_has_the_blocks_that_run() -> None:
    assert len(blocks()) == 4


@pytest.mark.slow
@pytest.mark.parametrize("index", [0, 1, 2, 3])
def test_block_runs_as_it_stands(index: int, tmp_path: Path) -> None:
    run = subprocess.run(
        [sys.executable, "-c", blocks()[index]], cwd=tmp_path, capture_output=True, text=True
    )
    assert run.returncode == 0, run.stderr
    assert index != 0 or ("Inclusion(" in run.stdout and (tmp_path / "map.vtu").is_file())

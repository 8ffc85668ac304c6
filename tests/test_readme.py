"""The Python of the README runs as it stands, and so does a newcomer's path through the verbs."""

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
    assert len(blocks()) == 5


def newcomers_path() -> list[list[str]]:
    """The commands from nothing to a warm start."""
    found = re.findall(r"```sh\n(tactorch generate.*?)```", README.read_text(), flags=re.DOTALL)
    return [line.split() for line in found[0].splitlines()]


@pytest.mark.slow
def test_a_newcomers_path(tmp_path: Path) -> None:
    """Twenty samples, two epochs, an inversion with the warm start; then what they leave."""
    path = newcomers_path()
    assert [words[1] for words in path] == ["generate", "train", "simulate", "invert"]
    for words in path:
        command = [sys.executable, "-m", *words]
        run = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
        assert run.returncode == 0, f"{' '.join(words)}\n{run.stdout}\n{run.stderr}"
    assert "surrogate's map is taken" in run.stdout + run.stderr
    (found,) = (tmp_path / "outputs" / "invert").glob("*/summary.json")
    assert '"start_mpa": "surrogate"' in found.read_text()


@pytest.mark.slow
@pytest.mark.parametrize("index", [0, 1, 2, 3, 4])
def test_block_runs_as_it_stands(index: int, tmp_path: Path) -> None:
    run = subprocess.run(
        [sys.executable, "-c", blocks()[index]], cwd=tmp_path, capture_output=True, text=True
    )
    assert run.returncode == 0, run.stderr
    assert index != 0 or ("Inclusion(" in run.stdout and (tmp_path / "map.vtu").is_file())

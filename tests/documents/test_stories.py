"""The stories: short, and they run from top to bottom with the input that a script makes."""

import importlib
import importlib.util
import json
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

from .blocks import DOCS, ROOT, blocks

PAGES = sorted((DOCS / "stories").glob("*.md"))
MAX_LINES = 40


def module(folder: str, name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"story_{name}", ROOT / folder / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    found = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = found  # dataclasses look their module up
    spec.loader.exec_module(found)
    return found


def name_of(path: Path) -> str:
    return path.stem


def test_there_are_stories() -> None:
    assert {page.stem for page in PAGES} == {"roboticist", "anatomist", "learner"}


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_the_code_is_short_and_parses(page: Path) -> None:
    """All its blocks are run: none is of a language or has an indent that is skipped."""
    found = module("benchmarks", "story_page").read_blocks(page)
    code = blocks(page, "python", "sh", "yaml", "toml")
    assert [block.text for block in found] == [block.text for block in code]
    assert 0 < sum(block.lines for block in found) < MAX_LINES
    for block in found:
        if block.language == "python":
            compile(block.text, page.name, "exec")


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_a_story_has_output_picture_and_time(page: Path) -> None:
    text = page.read_text()
    assert blocks(page, "text")
    assert f"../images/stories/{page.stem}.png" in text
    assert (DOCS / "images" / "stories" / f"{page.stem}.png").stat().st_size < 200_000
    told = json.loads((ROOT / "benchmarks" / "results" / "stories.json").read_text())
    story = told["stories"][page.stem]
    assert story["passed"]
    assert not any("output" in block for block in story["blocks"])  # which names folders
    assert story["seconds"] < 300.0
    assert f"{story['seconds']:.0f} s on two cores" in " ".join(text.split())
    assert story["lines"] == sum(
        block.lines for block in module("benchmarks", "story_page").read_blocks(page)
    )


def test_a_page_is_run_until_it_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pages = module("benchmarks", "story_page")
    monkeypatch.chdir(tmp_path)
    page = tmp_path / "page.md"
    page.write_text(
        "```sh\necho one > one.txt\n```\n\n```python\nx = open('one.txt').read()\n```\n\n"
        "```python\nprint(x, end='')\n\n```\n\n```sh\nfalse\necho no\n```\n\n```sh\necho two\n```\n"
    )
    found = pages.read_blocks(page)
    assert [block.lines for block in found] == [1, 1, 1, 2, 1]
    assert not pages.run(found)
    assert [block.output for block in found] == ["", "", "one\n", "", ""]
    assert [bool(block.error) for block in found] == [False, False, False, True, False]


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_a_story_runs(page: Path, tmp_path: Path) -> None:
    """In this environment; `benchmarks/stories.py` does it in that of the wheel."""
    if (ROOT / "examples" / "stories" / f"make_{page.stem}_data.py").is_file():
        module("examples/stories", f"make_{page.stem}_data").make(tmp_path / "story")
    folder, report = tmp_path / "story", tmp_path / "report.json"
    folder.mkdir(exist_ok=True)
    script = ROOT / "benchmarks" / "story_page.py"
    command = [sys.executable, str(script), str(page), str(report)]
    subprocess.run(command, cwd=folder, check=False, timeout=1200)
    told = json.loads(report.read_text())
    assert told["passed"], [block["error"] for block in told["blocks"]]
    check = {"roboticist": check_lump, "anatomist": check_lump, "learner": check_learner}
    check[page.stem](folder, "".join(block["output"] for block in told["blocks"]))


def check_lump(folder: Path, printed: str) -> None:
    """The first lump that was found is at its place, to within a fifth of the truth's size."""
    truth = json.loads((folder / "truth.json").read_text())
    (path,) = (folder / "runs").glob("*/finding.json")
    lump = json.loads(path.read_text())["lumps"][0]
    off = sum((a - b) ** 2 for a, b in zip(lump["center_mm"], truth["center_mm"], strict=True))
    assert off**0.5 < 0.25 * truth["radius_mm"]


def check_learner(folder: Path, printed: str) -> None:
    """The network's maps explain the presses better than the best uniform modulus."""
    first = dict(re.findall(r"^(cold|warm): chi2, iterations, seconds \[ *([\d.]+)", printed, re.M))
    assert float(first["warm"]) < 0.5 * float(first["cold"])

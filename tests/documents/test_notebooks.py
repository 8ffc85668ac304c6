"""The notebooks of the documentation: what they show is what they print."""

import math
import re
from pathlib import Path

import nbformat
import pytest
from nbformat import NotebookNode

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
_NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e-?\d+)?")
_SECONDS = re.compile(r"in [\d.]+ s|\([\d.]+ s\)")
# Relative difference of numbers, and the absolute one of small numbers: fTetWild makes other meshes
# each time, on which presses and the number of iterations differ.
_RELATIVE, _ABSOLUTE = 0.35, 0.15
# The modulus of the lump of this one has a 90 % interval of a factor of five.
_WIDER = {"own-body": 0.7}


def code_cells(notebook: NotebookNode) -> list[NotebookNode]:
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def texts(cell: NotebookNode) -> str:
    """What a cell prints and shows as text, without times."""
    parts = []
    for output in cell.outputs:
        if output.output_type == "stream" and output.name == "stdout":
            parts.append(output.text)
        elif output.output_type == "execute_result":
            parts.append(output.data.get("text/plain", ""))
    return _SECONDS.sub("", "\n".join(parts))


def test_there_are_notebooks() -> None:
    assert {path.stem for path in NOTEBOOKS} == {
        "first-inversion", "own-body", "own-network", "own-prior",
    }  # fmt: skip


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_all_cells_were_run_in_order_and_without_errors(path: Path) -> None:
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    cells = code_cells(notebook)
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    for cell in cells:
        for output in cell.outputs:
            assert output.output_type != "error"
            assert output.get("name") != "stderr", output.text
    assert notebook.cells[0].source.startswith("# ")
    assert path.stat().st_size < 600_000


def same(shown: str, printed: str, relative: float = _RELATIVE) -> bool:
    """Whether texts have the same words, and numbers that are nearly the same."""
    if _NUMBER.sub("", shown) != _NUMBER.sub("", printed):
        return False
    pairs = zip(_NUMBER.findall(shown), _NUMBER.findall(printed), strict=True)
    return all(
        math.isclose(float(one), float(other), rel_tol=relative, abs_tol=_ABSOLUTE)
        for one, other in pairs
    )


def test_texts_are_compared_by_words_and_numbers() -> None:
    assert same("radius 2.11 mm", "radius 2.12 mm")
    assert not same("radius 2.11 mm", "radius 3.61 mm")
    assert not same("radius 2.11 mm", "a radius 2.11 mm")
    assert not same("(1, 2)", "(1, 2, 3)")


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_prints_what_it_shows(path: Path, tmp_path: Path) -> None:
    from nbclient import NotebookClient

    stored = nbformat.read(path, as_version=4)
    again = nbformat.read(path, as_version=4)
    NotebookClient(
        again, timeout=900, kernel_name="python3", resources={"metadata": {"path": str(tmp_path)}}
    ).execute()
    for cell, before in zip(code_cells(again), code_cells(stored), strict=True):
        relative = _WIDER.get(path.stem, _RELATIVE)
        assert same(texts(before), texts(cell), relative), f"{texts(before)}\n---\n{texts(cell)}"

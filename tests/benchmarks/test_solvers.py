"""The benchmark of linear solvers: the same matrices for all, and what it says."""

import json
from pathlib import Path
from types import ModuleType

import pytest

NAME = "solvers"


def test_all_solvers_are_compared_on_the_same_matrices(
    benchmark: ModuleType, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    benchmark.main(["--divisions", "3", "--out", str(tmp_path)])
    printed = capsys.readouterr().out.splitlines()
    result = json.loads(printed[-1])
    assert "p_multigrid" in [row["solver"] for row in result["rows"]]
    assert all(row["unknowns"] == 3 * 7**3 for row in result["rows"])
    assert all(row["first_s"] > 0.0 and row["next_s"] > 0.0 for row in result["rows"])
    assert json.loads((tmp_path / "solvers.json").read_text())["rows"] == result["rows"]
    assert (tmp_path / "solvers.md").read_text().splitlines() == printed[:-1]

"""The table of closed loops, from runs whose numbers are given."""

import json
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

NAME = "closed_loop"


def made(rule: str, *widths: float | None, **values: Any) -> dict[str, Any]:
    return {
        "object": "deep", "rule": rule, "presses": len(widths), "lumps": 1,
        "widths_mm": list(widths), "width_mm": widths[-1], "error_mm": 0.1234,
        "cpu_seconds": 12.3, "reason": "known", **values,
    }  # fmt: skip


def test_the_table_tells_when_the_most_probable_lump_was_known(benchmark: ModuleType) -> None:
    runs = [made("lump_position", 0.5, 0.9, 1.2, 0.8), made("grid", None, 2.0), made("grid", None)]
    runs[2]["error_mm"] = None
    rows = benchmark.table(runs)[2:]
    # Not before the least number of presses of the stop rule.
    assert rows[0] == "| deep | lump_position | 4 | 4 | 1 | 0.80 | 0.12 | 12 | known |"
    assert rows[1].startswith("| deep | grid | 2 | - | 1 | 2.00 |")
    assert "| - | - |" in rows[2]
    columns = {line.count("|") for line in benchmark.table(runs)}
    assert len(columns) == 1


def test_candidates_are_on_the_top_and_begin_in_the_middle(benchmark: ModuleType) -> None:
    patches = benchmark.patches()
    assert len(patches) == 25
    assert patches[0].center == pytest.approx([5.0, 5.0, 10.0])
    for patch in patches:
        reach = abs(patch.center[:2] - 5.0).max() + patch.radius_mm
        assert reach < 5.0


def test_the_step_measures_the_distance_from_the_true_ball(benchmark: ModuleType) -> None:
    center = benchmark.BALLS["deep"][0].center_mm
    lump = {
        "center_mm": [center[0] + 0.3, center[1], center[2] - 0.4],
        "center_deviation_mm": [0.1, 0.1, 0.2],
        "probability": 0.99,
    }
    found = benchmark.step({"press": 4, "finding": {"lumps": [lump]}}, "deep")
    assert found["error_mm"] == pytest.approx(0.5)
    assert found["width_mm"] == pytest.approx(0.658, rel=1e-3)
    empty = benchmark.step({"press": 4, "finding": {"lumps": []}}, "deep")
    assert empty["error_mm"] is None


def test_runs_of_several_files_are_one_table(benchmark: ModuleType, tmp_path: Path) -> None:
    files = [tmp_path / name for name in ("a.json", "b.json")]
    for file, runs in zip(files, [[made("grid", 0.5)], [made("lump_position", 0.9)]], strict=True):
        file.write_text(json.dumps({"seed": 0, "stop": 1.0, "runs": runs}))
    assert [one["rule"] for one in benchmark.merged(files, 0)] == ["lump_position", "grid"]
    with pytest.raises(SystemExit, match="as a file before"):
        benchmark.merged([files[0], files[0]], 0)
    with pytest.raises(SystemExit, match="another seed"):
        benchmark.merged(files, 1)

import json
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

NAME = "design_factors"


@pytest.mark.parametrize(
    ("cell", "pressures_kpa", "sides"),
    [
        ("p1", [5], 1),
        ("p3", [5, 10, 15], 1),
        ("t2", [20], 1),
        ("t5", [5, 10, 15, 20], 1),
        ("t9", [2.5 * k for k in range(1, 9)], 1),
        ("dir2", [2.5 * k for k in range(1, 9)] * 2, 2),
    ],
)
def test_cells_press_as_table_2_says(
    benchmark: ModuleType, cell: str, pressures_kpa: list[float], sides: int
):
    setting = benchmark.CELLS[cell]
    plan = benchmark.plan_of(setting)
    assert len(plan.faces) == sides
    assert np.allclose([1e3 * p for p in plan.pressures_mpa] * sides, pressures_kpa)


def test_the_papers_table_is_read_by_cell(benchmark: ModuleType, tmp_path: Path):
    columns = list(benchmark.CELLS)
    model = {metric: list(range(len(columns))) for metric in benchmark.METRICS}
    path = tmp_path / "paper.json"
    table = {"columns": columns, "model1": model, "model2": model}
    path.write_text(json.dumps({"table2": table}))
    paper = benchmark._paper(path)
    assert paper["model2"]["dir1"]["ssim"] == columns.index("dir1")

"""The cells of Table II."""

import json

import numpy as np
import pytest

from tactorch.reproduce.design import CELLS, cases, make_plan


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
def test_cells_press_as_table_2_says(cell: str, pressures_kpa: list[float], sides: int):
    plan = make_plan(CELLS[cell])
    assert len(plan.faces) == sides
    assert np.allclose([1e3 * p for p in plan.pressures_mpa] * sides, pressures_kpa)


def test_cells_that_are_the_same_are_made_once():
    options = {"meshes": ["same", "other"], "relative_edge_length": 0.1}
    made = cases(options)
    # p4 is t5, t9 is dir1, and amp10 is snr20.
    assert len(made) == 2 * 2 * (len(CELLS) - 3)
    assert len({json.dumps(settings) for settings in made.values()}) == len(made)

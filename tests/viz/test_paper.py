"""Pictures in the form of the paper's figures."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from tactorch.errors import ConfigError
from tactorch.mesh import box_mesh
from tactorch.viz import save_figure
from tactorch.viz.paper import (
    Panel,
    boxes_figure,
    curves_figure,
    matrices_figure,
    panels_figure,
)

MESH = box_mesh(10.0, 3)


def is_drawn(figure: Figure, folder: Path) -> bool:
    return save_figure(figure, folder / "a.png").read_bytes()[:4] == b"\x89PNG"


def test_panels_of_unlike_rows_are_drawn(tmp_path):
    one = Panel(MESH, np.full(MESH.n_tets, 0.2), (0.0, 1.0), title="t", caption="c")
    marked = Panel(MESH, np.full(MESH.n_tets, 1.0), (0.0, 1.0), 2, marks_mm=np.full((2, 3), 5.0))
    assert is_drawn(panels_figure({"a": [one, marked], "b": [one]}), tmp_path)


def test_boxes_curves_and_matrices_are_drawn(tmp_path):
    depths = {2.0: [2.1, 1.9, 2.0], 3.0: [3.2]}
    assert is_drawn(boxes_figure(depths, title="r"), tmp_path)
    curves = {"one": {"a": np.arange(3.0), "b": np.ones(3)}, "two": {"a": np.zeros(3)}}
    assert is_drawn(curves_figure(curves, columns=2, ylabel="y"), tmp_path)
    matrices = {"m": (np.eye(2), ("a", "b"))}
    assert is_drawn(matrices_figure(matrices), tmp_path)


def test_nothing_to_draw_is_refused():
    for draw in (
        lambda: panels_figure({"a": []}),
        lambda: boxes_figure({2.0: []}),
        lambda: matrices_figure({}),
        lambda: curves_figure({"a": {}}, columns=1, ylabel=""),
    ):
        with pytest.raises(ConfigError):
            draw()

"""Pictures in the form of the paper's figures."""

from pathlib import Path

import numpy as np
import pytest

from tactorch.errors import ConfigError
from tactorch.mesh import box_mesh
from tactorch.viz.paper import Panel, plot_boxes, plot_curves, plot_matrices, plot_panels

MESH = box_mesh(10.0, 3)


def is_picture(path: Path) -> bool:
    return path.read_bytes()[:4] == b"\x89PNG"


def test_panels_of_unlike_rows_are_drawn(tmp_path):
    one = Panel(MESH, np.full(MESH.n_tets, 0.2), (0.0, 1.0), title="t", caption="c")
    marked = Panel(MESH, np.full(MESH.n_tets, 1.0), (0.0, 1.0), 2, marks_mm=np.full((2, 3), 5.0))
    assert is_picture(plot_panels([[one, marked], [one]], ["a", "b"], tmp_path / "p.png"))


def test_boxes_curves_and_matrices_are_drawn(tmp_path):
    depths = {2.0: [2.1, 1.9, 2.0], 3.0: [3.2]}
    assert is_picture(plot_boxes(depths, tmp_path / "b.png", reference="r"))
    curves = {"one": {"a": np.arange(3.0), "b": np.ones(3)}, "two": {"a": np.zeros(3)}}
    assert is_picture(plot_curves(curves, tmp_path / "c.png", columns=2, across="x", up="y"))
    matrices = {"m": (np.eye(2), ("a", "b"))}
    assert is_picture(plot_matrices(matrices, tmp_path / "m.png"))


def test_nothing_to_draw_is_refused(tmp_path):
    for draw in (
        lambda path: plot_panels([[]], ["a"], path),
        lambda path: plot_boxes({2.0: []}, path),
        lambda path: plot_matrices({}, path),
        lambda path: plot_curves({"a": {}}, path, columns=1, across="", up=""),
    ):
        with pytest.raises(ConfigError):
            draw(tmp_path / "none.png")
    assert not list(tmp_path.iterdir())

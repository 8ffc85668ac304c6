from pathlib import Path

import numpy as np
import pytest

from tactorch.errors import ConfigError
from tactorch.mesh import TetMesh
from tactorch.viz.credibility import METRIC, credibility_figure, plot_layers


def test_layer_curves_are_written(tmp_path: Path) -> None:
    curve = (np.arange(5.0), np.geomspace(1, 100, 5))
    path = plot_layers({"0.1 MPa": curve, "0.2 MPa": (curve[0], 2 * curve[1])}, tmp_path / "a.png")
    assert path.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    with pytest.raises(ConfigError, match="no curve"):
        plot_layers({}, tmp_path / "b.png")


def test_slices_name_the_metric(cube: TetMesh) -> None:
    figure = credibility_figure(cube, cube.centroids[:, 2], n_slices=1)
    assert [axes.get_ylabel() for axes in figure.axes if not axes.images] == [METRIC]

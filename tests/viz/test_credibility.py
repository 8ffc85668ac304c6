from pathlib import Path

import numpy as np
import pytest

from tactorch.errors import ConfigError
from tactorch.mesh import TetMesh
from tactorch.viz import (
    calibration_figure,
    credibility_figure,
    depth_figure,
    layer_figure,
    save_figure,
)
from tactorch.viz.uncertainty import METRIC


def test_layer_curves_are_written(tmp_path: Path) -> None:
    curve = (np.arange(5.0), np.geomspace(1, 100, 5))
    figure = layer_figure({"0.1 MPa": curve, "0.2 MPa": (curve[0], 2 * curve[1])})
    path = save_figure(figure, tmp_path / "a.png")
    assert path.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    with pytest.raises(ConfigError, match="no curve"):
        layer_figure({})


def test_slices_name_the_metric(cube: TetMesh) -> None:
    figure = credibility_figure(cube, cube.centroids[:, 2], n_slices=1)
    assert [axes.get_ylabel() for axes in figure.axes if not axes.images] == [METRIC]


def test_calibration_curves_stand_at_their_levels(tmp_path: Path) -> None:
    levels = np.linspace(0.05, 0.95, 19)
    figure = calibration_figure({"bold": levels**2})
    line = next(line for line in figure.axes[0].lines if line.get_label() == "bold")
    np.testing.assert_allclose(line.get_xdata(), levels)
    assert save_figure(figure, tmp_path / "c.png").stat().st_size > 0
    with pytest.raises(ConfigError, match="no curve"):
        calibration_figure({})


def test_depths_run_downwards_from_the_top(cube: TetMesh, tmp_path: Path) -> None:
    groups = {"soft": {"1 kPa": np.array([4.0, 2.0]), "2 kPa": np.array([8.0, 4.0])}}
    values = np.ones(cube.n_tets)
    figure = depth_figure(groups, cube, values)
    np.testing.assert_allclose(figure.axes[0].lines[0].get_xdata(), [0.25, 0.75])
    assert [len(axes.lines) for axes in figure.axes if axes.get_title() == "soft"] == [2]
    titles = [axes.get_title() for axes in figure.axes if axes.images]
    heights = [float(title.split()[2]) for title in titles]
    assert heights == sorted(heights, reverse=True)
    assert save_figure(figure, tmp_path / "d.png").stat().st_size > 0
    with pytest.raises(ConfigError, match="no curve"):
        depth_figure({"soft": {}}, cube, values)

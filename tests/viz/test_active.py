from pathlib import Path

import numpy as np
import pytest

from tactorch.errors import ConfigError
from tactorch.mesh import Sphere
from tactorch.viz import sampling_figure, save_figure

CURVES = {"uniform": np.array([[3.0, 2.0], [5.0, 4.0]]), "ours": np.array([[3.0, 1.0]])}
PLACES = {"ours": np.array([[0.0, 0.0, 10.0], [4.0, 0.0, 9.0]])}


def test_curves_are_means_with_their_spread() -> None:
    axes = sampling_figure(CURVES, {}, target=2.5).axes[0]
    lines = {line.get_label(): line for line in axes.get_lines()}
    np.testing.assert_allclose(lines["uniform"].get_ydata(), [4.0, 3.0])
    np.testing.assert_allclose(lines["uniform"].get_xdata(), [1, 2])
    assert lines["target"].get_ydata()[0] == 2.5
    assert len(axes.collections) == 1  # one run has no spread


def test_places_are_numbered_over_the_inclusions() -> None:
    ball = Sphere((2.0, 1.0, 5.0), 1.5)
    panel = sampling_figure(CURVES, PLACES, balls=[ball], outline_mm=10.0).axes[1]
    assert [text.get_text() for text in panel.texts] == ["1", "2"]
    assert panel.texts[1].get_position() == (4.0, 0.0)
    corners = panel.patches[0].get_path().vertices
    np.testing.assert_allclose(corners.max(axis=0), [3.5, 2.5])


def test_is_written_and_needs_a_curve(tmp_path: Path) -> None:
    assert save_figure(sampling_figure(CURVES, PLACES), tmp_path / "a.png").stat().st_size > 1000
    with pytest.raises(ConfigError, match="no curve"):
        sampling_figure({}, {})

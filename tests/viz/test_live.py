from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.image import imread

from tactorch.mesh import TetMesh
from tactorch.sampling import Patch
from tactorch.viz import save_figure
from tactorch.viz.slices import live_figure


def test_the_next_press_is_drawn_where_it_is_and_the_inclusion_crossed(
    cube: TetMesh, sphere_map: np.ndarray, tmp_path: Path
) -> None:
    pressed = np.zeros((cube.n_points, 3))
    pressed[cube.points[:, 2] > cube.bounds[1, 2] - 1e-9, 2] = -1.0
    low, high = cube.bounds
    place = np.array([high[0], *(0.5 * (low + high))[1:]])
    figure = live_figure(
        cube,
        sphere_map,
        pressed=pressed,
        inclusion_mm=cube.bounds.mean(axis=0),
        next_press=Patch(place, np.array([-1.0, 0.0, 0.0]), 2.0),
    )
    path = save_figure(figure, tmp_path / "live.png")
    picture = imread(path)[..., :3]
    marked = (np.abs(picture - to_rgb("#CC3399")).max(axis=-1) < 0.02).sum()
    assert marked > 100
    assert (np.abs(picture - to_rgb("#D55E00")).max(axis=-1) < 0.02).sum() > 200


@pytest.mark.parametrize("following", [True, False])
def test_without_a_suggestion_there_is_one_row(
    cube: TetMesh, sphere_map: np.ndarray, following: bool
) -> None:
    place = Patch(cube.bounds[1], np.array([0.0, 0.0, -1.0]), 1.0) if following else None
    pressed = np.zeros((cube.n_points, 3))
    figure = live_figure(cube, sphere_map, pressed=pressed, next_press=place)
    assert len([axes for axes in figure.axes if axes.images]) == (6 if following else 3)

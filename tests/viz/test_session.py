"""Pictures of a recorded session."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from tactorch.errors import ConfigError
from tactorch.mesh import box_mesh
from tactorch.recording import MaterialSpec, Press, Recording
from tactorch.viz import presses as drawing
from tactorch.viz import save_figure
from tactorch.viz.presses import plane_across, presses_figure, push_direction

MESH = box_mesh(10.0, 3)
TOP = MESH.points[:, 2] > 9.99


def press(depth_mm: float, force_n: float, step: int, **changes: object) -> Press:
    down = np.array((0.0, 0.0, -1.0))
    forces = np.where(TOP[:, None], force_n / TOP.sum() * down, 0.0)
    moved = np.where(TOP[:, None], depth_mm * down, np.nan)
    fixed = np.repeat(MESH.points[:, 2:] < 0.01, 3, axis=1)
    fields = {"fixed": fixed, "step": step, "direction": down, "name": f"step {step}", **changes}
    return Press(forces, np.repeat(TOP[:, None], 3, axis=1), moved, **fields)


@pytest.fixture
def recording() -> Recording:
    made = tuple(press(0.2 * (i + 1), 0.5 * (i + 1), i) for i in range(3))
    return Recording(MESH, made, MaterialSpec("neo_hookean", 0.45))


def test_presses_are_drawn(recording: Recording, tmp_path: Path) -> None:
    image = imread(save_figure(presses_figure(recording), tmp_path / "presses.png"))
    assert image.shape[1] > image.shape[0]  # three side by side
    one = imread(save_figure(presses_figure(recording, max_presses=1), tmp_path / "one.png"))
    assert one.shape[1] < image.shape[1] / 1.8
    assert image[..., :3].std() > 0.05
    with pytest.raises(ConfigError, match="max_presses=0 must be at least 1"):
        presses_figure(recording, max_presses=0)


def test_the_hardest_are_drawn_where_there_are_too_many(recording: Recording) -> None:
    assert [one.step for one in drawing._select(recording, 2)] == [1, 2]


@pytest.mark.parametrize("push", [(0.0, 0.0, -1.0), (1.0, 0.0, 0.0), (0.6, 0.0, -0.8)])
def test_axes_across_a_direction(push: tuple[float, float, float]) -> None:
    along = np.array(push)
    across = plane_across(along)
    np.testing.assert_allclose(across @ along, 0.0, atol=1e-12)
    np.testing.assert_allclose(across @ across.T, np.eye(2), atol=1e-12)
    assert across[1].max() > 0.5  # the second is along an axis of the object, not against it


def test_a_press_without_direction_is_seen_along_its_force() -> None:
    lone = press(0.2, 0.5, 0, direction=None)
    np.testing.assert_allclose(push_direction(lone), (0, 0, -1))

from dataclasses import replace

import numpy as np
import pytest

from tactorch.inverse.result.lump import measure_depth
from tactorch.mesh import box_mesh, face_nodes
from tactorch.recording import Press


def pushed(*sides: str) -> Press:
    """A push of 1 N in all, inwards from each of some sides."""
    forces = np.zeros((MESH.n_points, 3))
    for side in sides:
        nodes = face_nodes(MESH, side)
        axis, inward = "xyz".index(side[0]), -1.0 if side[1] == "+" else 1.0
        forces[nodes, axis] += inward / len(nodes)
    moved = np.where(forces != 0, 0.1 * np.sign(forces), 0.0)
    return Press(
        forces=forces, observed=forces != 0, displacement=moved, springs=np.ones_like(forces)
    )


MESH = box_mesh(10.0, 4, tets_per_cell=5)
CENTER = np.array([5.0, 4.0, 7.5])
NEAR = np.linalg.norm(MESH.centroids - CENTER, axis=1) < 2.5


def test_it_is_told_from_the_side_that_is_nearest() -> None:
    found = measure_depth(MESH, [pushed("z+"), pushed("y-")], CENTER, NEAR)
    assert found is not None
    assert found.center_mm == pytest.approx(2.5)
    np.testing.assert_allclose(found.inward, (0, 0, -1))


def test_a_grip_from_opposite_sides_pushes_nowhere() -> None:
    grip = pushed("x+", "x-")
    noise = np.random.default_rng(0).normal(scale=1e-9, size=grip.forces.shape)
    grip = replace(grip, forces=grip.forces + noise * (grip.forces != 0))
    assert measure_depth(MESH, [grip], CENTER, NEAR) is None
    found = measure_depth(MESH, [grip, pushed("y-")], CENTER, NEAR)
    assert found is not None
    assert found.center_mm == pytest.approx(4.0)

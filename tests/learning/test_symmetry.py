import numpy as np
import pytest
import torch

from tactorch.learning.data import apply_symmetry, symmetries
from tactorch.mesh import VoxelGrid, box_mesh

X, Y, Z = np.eye(3)


@pytest.mark.parametrize(
    ("pushes", "count"),
    [([-Z], 8), ([-Z, -X], 4), ([-Z, -X, -Y], 6), ([X, -X, Y, -Y, Z, -Z], 48), ([Z, -Z], 16)],
)
def test_symmetries_are_those_of_the_pressed_sides(pushes: list, count: int) -> None:
    found = symmetries(np.array(pushes))
    assert len(found) == count
    assert ((0, 1, 2), (1, 1, 1)) in found


def test_a_field_is_seen_as_by_coordinates() -> None:
    """Scalars and vectors, against the same function of turned coordinates."""
    grid = VoxelGrid(box_mesh(2.0, 1, center_mm=(0.0, 0.0, 0.0)), 6)
    points = grid.centres.reshape(-1, 3)

    def scalar(p: np.ndarray) -> np.ndarray:
        return p[:, 0] + 2 * p[:, 1] ** 2 - 3 * p[:, 2] ** 3

    def vector(p: np.ndarray) -> np.ndarray:
        return np.column_stack((p[:, 1], p[:, 2] ** 2, p[:, 0] - p[:, 1]))

    values = np.column_stack((scalar(points), vector(points))).T.reshape(4, 6, 6, 6)
    for order, signs in symmetries(np.array([X, -X, Y, -Y, Z, -Z])):
        Q = np.zeros((3, 3))  # image = Q original
        Q[range(3), order] = signs
        back = points @ Q  # where an image point comes from
        expected = np.column_stack((scalar(back), vector(back) @ Q.T)).T.reshape(4, 6, 6, 6)
        found = apply_symmetry((order, signs), torch.from_numpy(values), vectors=(1,))
        np.testing.assert_allclose(found.numpy(), expected, atol=1e-12)

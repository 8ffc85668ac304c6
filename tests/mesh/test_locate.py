import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactorch.mesh import TetMesh, box_mesh, locate


def uneven_mesh(seed: int = 0) -> TetMesh:
    """Flat cells with displaced nodes: the nearest centroid often belongs to a neighbour."""
    mesh = box_mesh((12.0, 12.0, 2.0), (3, 3, 4))
    inner = ((mesh.points > mesh.bounds[0] + 0.1) & (mesh.points < mesh.bounds[1] - 0.1)).all(
        axis=1
    )
    step = np.random.default_rng(seed).uniform(-0.1, 0.1, mesh.points.shape) * [4.0, 4.0, 0.5]
    return TetMesh(mesh.points + step * inner[:, None], mesh.tets)


def brute_force(mesh: TetMesh, points: np.ndarray) -> np.ndarray:
    """Test every point against every element, by the signs of four volumes."""
    corners = mesh.points[mesh.tets]
    inside = np.ones((len(points), mesh.n_tets), dtype=bool)
    for i in range(4):
        with_point = np.broadcast_to(corners, (len(points), *corners.shape)).copy()
        with_point[:, :, i] = points[:, None]
        edges = with_point[:, :, 1:] - with_point[:, :, :1]
        inside &= np.linalg.det(edges) > 0
    return np.where(inside.any(axis=1), inside.argmax(axis=1), -1)


@pytest.mark.parametrize("k", [1, 8, 10_000])
def test_agrees_with_brute_force_whatever_is_tried_first(k: int) -> None:
    mesh = uneven_mesh()
    points = np.random.default_rng(1).uniform(-1.0, 13.0, (300, 3)) * [1.0, 1.0, 0.2]
    expected = brute_force(mesh, points)
    assert 0 < (expected < 0).sum() < 300
    np.testing.assert_array_equal(locate(mesh, points, k=k), expected)


@settings(max_examples=30)
@given(
    element=st.integers(0, 215),
    weights=st.lists(st.floats(0.01, 1.0), min_size=4, max_size=4),
)
def test_point_mixed_from_the_corners_is_in_that_element(
    element: int, weights: list[float]
) -> None:
    mesh = uneven_mesh()
    share = np.array(weights) / sum(weights)
    point = share @ mesh.points[mesh.tets[element]]
    assert locate(mesh, point[None])[0] == element


def test_nodes_and_centroids_are_inside_and_far_points_outside() -> None:
    mesh = uneven_mesh()
    nodes = locate(mesh, mesh.points)
    assert (mesh.tets[nodes] == np.arange(mesh.n_points)[:, None]).any(axis=1).all()
    np.testing.assert_array_equal(locate(mesh, mesh.centroids), np.arange(mesh.n_tets))
    np.testing.assert_array_equal(locate(mesh, mesh.points + 100.0), -1)
    assert locate(mesh, np.empty((0, 3))).shape == (0,)

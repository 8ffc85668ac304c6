import numpy as np
import pytest

from tactorch.errors import ConfigError, TactorchError
from tactorch.mesh import TetMesh, face_nodes
from tactorch.viz.contact import arrow_positions, contact_patches, cut_triangles


def forces_on(cube: TetMesh, face: str, force: list[float]) -> np.ndarray:
    forces = np.zeros((cube.n_points, 3))
    forces[face_nodes(cube, face)] = force
    return forces


@pytest.mark.parametrize("position", [10.0, 11.3])  # through nodes, and between them
def test_cut_through_the_surface_is_its_outline(cube: TetMesh, position: float) -> None:
    segments = cut_triangles(cube.points, cube.surface.triangles, 2, position)
    length = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1).sum()
    assert length == pytest.approx(80.0)
    on_edge = np.isclose(segments, 0.0) | np.isclose(segments, 20.0)
    assert on_edge.any(axis=2).all()


def test_face_names_and_forces_mark_the_same_contact(cube: TetMesh) -> None:
    (named,) = contact_patches(cube, ["z+"])
    (loaded,) = contact_patches(cube, forces_on(cube, "z+", [0.0, 0.0, -0.01]))
    np.testing.assert_array_equal(np.unique(named.triangles), np.unique(loaded.triangles))
    np.testing.assert_allclose(named.direction, [0.0, 0.0, -1.0])
    np.testing.assert_allclose(loaded.direction, named.direction)
    segments = cut_triangles(cube.points, loaded.triangles, 0, 6.0)
    np.testing.assert_allclose(segments[..., 1], 20.0)
    assert np.ptp(segments[..., 0]) == pytest.approx(20.0)


def test_faces_pushed_different_ways_are_apart(cube: TetMesh) -> None:
    forces = forces_on(cube, "z+", [0, 0, -0.01]) + forces_on(cube, "x-", [0.01, 0, 0])
    patches = contact_patches(cube, forces)
    directions = sorted(tuple(np.round(patch.direction, 6) + 0.0) for patch in patches)
    assert directions == [(0.0, 0.0, -1.0), (1.0, 0.0, 0.0)]


def test_force_on_one_node_marks_the_triangles_around_it(cube: TetMesh) -> None:
    forces = np.zeros((cube.n_points, 3))
    node = face_nodes(cube, "y-")[40]
    forces[node, 1] = 1.0
    (patch,) = contact_patches(cube, forces)
    assert (patch.triangles == node).any(axis=1).all()
    np.testing.assert_allclose(patch.direction, [0.0, 1.0, 0.0])


def test_no_force_means_no_contact(cube: TetMesh) -> None:
    assert contact_patches(cube, np.zeros((cube.n_points, 3))) == []


def test_arrows_spread_over_the_contact_and_point_along_the_push(cube: TetMesh) -> None:
    (patch,) = contact_patches(cube, ["z+"])
    segments = cut_triangles(cube.points, patch.triangles, 0, 6.0)
    tips, along = arrow_positions(segments, patch.direction, 0)
    np.testing.assert_allclose(along, [0.0, -1.0])
    np.testing.assert_allclose(np.sort(tips[:, 0]), [10 / 3, 10.0, 50 / 3], atol=1.3)
    np.testing.assert_allclose(tips[:, 1], 20.0)


def test_push_across_the_slice_has_no_arrow(cube: TetMesh) -> None:
    (patch,) = contact_patches(cube, ["x-"])
    segments = cut_triangles(cube.points, cube.surface.triangles, 0, 6.0)
    tips, _ = arrow_positions(segments, patch.direction, 0)
    assert len(tips) == 0


def test_unusable_contact_is_refused(cube: TetMesh) -> None:
    with pytest.raises(TactorchError, match=r"pressed: forces of shape \(5, 3\).* 729 nodes"):
        contact_patches(cube, np.zeros((5, 3)))
    broken = forces_on(cube, "z+", [0.0, np.nan, 0.0])
    with pytest.raises(TactorchError, match="not finite"):
        contact_patches(cube, broken)
    with pytest.raises(ConfigError, match="top"):
        contact_patches(cube, ["top"])

import numpy as np
import pytest

from tactorch.errors import ConfigError, MeshError
from tactorch.mesh import FACE_NAMES, TetMesh, box_mesh, face_nodes, select_face


@pytest.mark.parametrize("name", FACE_NAMES)
def test_each_side_is_whole_and_flat(mesh: TetMesh, name: str) -> None:
    axis, sign = "xyz".index(name[0]), 1 if name[1] == "+" else -1
    plane = mesh.bounds[int(sign > 0), axis]
    found = select_face(mesh, name)
    assert mesh.surface.areas[found].sum() == pytest.approx([2.0, 3.0, 6.0][axis])
    np.testing.assert_allclose(mesh.surface.normals[found, axis], sign)
    expected = np.flatnonzero(mesh.points[:, axis] == plane)
    np.testing.assert_array_equal(face_nodes(mesh, name), expected)


def test_sides_cover_a_box_without_overlap(mesh: TetMesh) -> None:
    found = np.concatenate([select_face(mesh, name) for name in FACE_NAMES])
    np.testing.assert_array_equal(np.sort(found), np.arange(len(mesh.surface.triangles)))


def test_tolerance_is_a_share_of_the_diagonal() -> None:
    mesh = box_mesh(10.0, 2)
    points = np.array(mesh.points)
    top = points[:, 2] == 10.0
    points[top & (points[:, 0] == 5.0), 2] = 10.0 - 0.01 * mesh.diagonal
    dented = TetMesh(points, mesh.tets)
    with pytest.raises(MeshError, match=r"side 'z\+' within 0\.002 .* not flat"):
        select_face(dented, "z+")
    assert len(face_nodes(dented, "z+", tolerance=0.011)) == 9


def test_thin_side_walls_are_no_part_of_the_top() -> None:
    plate = box_mesh((1000.0, 1000.0, 1.0), (2, 2, 1))
    assert plate.diagonal * 2e-3 > 1.0
    np.testing.assert_allclose(plate.surface.normals[select_face(plate, "z+"), 2], 1.0)


@pytest.mark.parametrize("name", ["top", "z", "", "w-"])
def test_unknown_names(mesh: TetMesh, name: str) -> None:
    with pytest.raises(ConfigError, match=f"Unknown face '{name}'.*x-, x"):
        select_face(mesh, name)


@pytest.mark.parametrize("tolerance", [-1e-3, 0.5, float("nan")])
def test_unusable_tolerance(mesh: TetMesh, tolerance: float) -> None:
    with pytest.raises(ConfigError, match="tolerance"):
        select_face(mesh, "x-", tolerance)

"""From the sensor's frame to the object's: poses in time, and forces that press as a whole."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tactorch.errors import ConfigError, FileError
from tactorch.mesh import box_mesh
from tactorch.sensor.contact import (
    check_pose,
    interpolate_displacements,
    rotate_vectors,
    transfer_forces,
    transform_points,
)
from tactorch.sensor.poses import Poses, read_poses

MESH = box_mesh(10.0, 5)
TOP = MESH.surface.triangles[(MESH.points[MESH.surface.triangles][..., 2] > 9.99).all(axis=1)]


def pose(angles_deg: tuple[float, float, float], place: tuple[float, float, float]) -> np.ndarray:
    found = np.eye(4)
    found[:3, :3] = Rotation.from_euler("xyz", angles_deg, degrees=True).as_matrix()
    found[:3, 3] = place
    return found


@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 12))
def test_forces_keep_sum_and_moment(seed: int, count: int) -> None:
    """Wherever they act near the surface, on and off it, inside and beyond its edge."""
    rng = np.random.default_rng(seed)
    points = np.column_stack([rng.uniform(-0.5, 10.5, (count, 2)), rng.normal(10.0, 0.3, count)])
    forces = rng.normal(size=(count, 3))
    found = transfer_forces(points, forces, MESH.points, TOP)
    np.testing.assert_allclose(found.sum(axis=0), forces.sum(axis=0), atol=1e-9)
    moment = np.cross(points, forces).sum(axis=0)
    np.testing.assert_allclose(np.cross(MESH.points, found).sum(axis=0), moment, atol=1e-7)
    assert (found[MESH.points[:, 2] < 9.9] == 0).all()


def test_a_force_on_a_node_stays_there() -> None:
    node = int(np.argmin(np.linalg.norm(MESH.points - (4.0, 6.0, 10.0), axis=1)))
    found = transfer_forces(MESH.points[[node]], np.array([(0.1, 0.2, -1.0)]), MESH.points, TOP)
    np.testing.assert_allclose(found[node], (0.1, 0.2, -1.0), atol=1e-12)
    assert np.count_nonzero(np.abs(found).max(axis=1) > 1e-12) == 1


def test_displacements_are_carried_where_they_were_seen() -> None:
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(2, 8, (80, 2)), np.full(80, 10.0)])

    def field(at: np.ndarray) -> np.ndarray:
        x, y = at[:, 0] - 5, at[:, 1] - 5
        return np.stack([0.1 * x, 0.05 * y + 0.02 * x, -0.5 * np.exp(-(x**2 + y**2) / 8)], axis=1)

    seen = field(points)
    seen[3] = np.nan
    top = np.unique(TOP)
    found = interpolate_displacements(points, seen, MESH.points[top], np.array([0.0, 0.0, 1.0]))
    inside = np.isfinite(found).all(axis=1)
    assert np.isnan(found[~inside]).all()
    assert 4 <= inside.sum() < len(top)
    np.testing.assert_allclose(found[inside], field(MESH.points[top])[inside], atol=0.02)


@given(
    angles=st.tuples(*[st.floats(-170, 170)] * 3), place=st.tuples(*[st.floats(-50, 50)] * 3)
)  # fmt: skip
def test_points_turn_and_move_and_vectors_turn(angles: tuple, place: tuple) -> None:
    T = pose(angles, place)
    points = np.random.default_rng(0).normal(size=(5, 3))
    both = np.column_stack([points, np.ones(5)]) @ T.T
    np.testing.assert_allclose(transform_points(T, points), both[:, :3], atol=1e-9)
    np.testing.assert_allclose(
        rotate_vectors(T, points),
        transform_points(T, points) - transform_points(T, np.zeros((1, 3))),
        atol=1e-9,
    )


def test_poses_between_those_known() -> None:
    poses = Poses(np.array([0.0, 1.0]), np.stack([np.eye(4), pose((0, 0, 90), (2, 0, 4))]))
    (middle,) = poses.at([0.5])
    np.testing.assert_allclose(middle, pose((0, 0, 45), (1, 0, 2)), atol=1e-12)
    np.testing.assert_allclose(poses.at([0.0, 1.0]), poses.T_object_sensor, atol=1e-12)
    with pytest.raises(ConfigError, match=r"1 of 2 frames have no pose.*to 1.500 s, poses from"):
        poses.at([0.5, 1.5])


def test_tables_of_poses(tmp_path: Path) -> None:
    path = tmp_path / "poses.csv"
    head = "time_s,x_mm,y_mm,z_mm,qw,qx,qy,qz\n"
    path.write_text(head + "0,1,2,3,1,0,0,0\n0.5,1,2,2.5,0.70710678,0,0,0.70710678\n")
    found = read_poses(path)
    np.testing.assert_allclose(found.T_object_sensor[1], pose((0, 0, 90), (1, 2, 2.5)), atol=1e-7)
    np.testing.assert_allclose(found.relative_to(0.2).time_s, [-0.2, 0.3])
    path.write_text(path.read_text() + "1,1,2,2.5,0.70710678,0,0,0.70")  # being written
    assert len(read_poses(path, growing=True)) == 2
    assert len(read_poses(path)) == 3
    for text, message in (
        ("time_s,x_mm\n0,1\n", "lacks the column y_mm"),
        (head + "0,1,2,a,1,0,0,0\n", "line 2: could not convert"),
        (head + "0,1,2,3,0.5,0,0,0\n", "line 2: the quaternion has length 0.5"),
        (head, "there is no pose"),
        (head + "1,1,2,3,1,0,0,0\n0.5,1,2,3,1,0,0,0\n", "time_s must rise: pose 1"),
    ):
        path.write_text(text)
        with pytest.raises((FileError, ConfigError), match=message) as caught:
            read_poses(path)
        assert "poses.csv" in str(caught.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda T: T * 0.0 + np.diag([0, 0, 0, 1.0]), "singular"),
        (lambda T: T @ np.diag([1, 1, -1, 1.0]), "mirrors"),
        (lambda T: T @ np.diag([1.1, 1, 1, 1.0]), "not orthonormal"),
        (lambda T: pose((10, 0, 0), (1, 2, 3)).T, "last row"),
        (lambda T: T + np.nan, "not finite"),
        (lambda T: pose((0, 0, 0), (2e4, 0, 0)), "20000|2e\\+04"),
    ],
)
def test_what_is_no_pose(change: object, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        check_pose(change(np.eye(4)))


def test_too_little_is_known() -> None:
    points = np.random.default_rng(0).uniform(size=(6, 3))
    up = np.array([0.0, 0.0, 1.0])
    with pytest.raises(ConfigError, match="0 displacements are known"):
        interpolate_displacements(points, np.full((6, 3), np.nan), points, up)
    line = np.column_stack([np.arange(6.0), np.zeros(6), np.zeros(6)])
    with pytest.raises(ConfigError, match="on a line"):
        interpolate_displacements(line, np.zeros((6, 3)), points, up)
    with pytest.raises(ConfigError, match="no surface"):
        transfer_forces(points, points, MESH.points, TOP[:0])

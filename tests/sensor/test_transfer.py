"""Forces of the gel's nodes on the nodes of the object."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import Delaunay

from tactorch.mesh import box_mesh
from tactorch.mesh.tractions import LoadedSurface
from tactorch.sensor.transfer import transfer_forces

MESH = box_mesh((10.0, 10.0, 4.0), (8, 8, 2))
TOP = MESH.surface.triangles[MESH.surface.normals[:, 2] > 0.9]
AREAS = MESH.surface.areas[MESH.surface.normals[:, 2] > 0.9]


def surface(seed: int, count: int) -> tuple[np.ndarray, np.ndarray, LoadedSurface]:
    """An irregular mesh of the square from 2 to 8 mm, and its triangles."""
    rng = np.random.default_rng(seed)
    line = np.linspace(2.0, 8.0, 7)
    rim = [np.column_stack([line, np.full(7, end)]) for end in (2.0, 8.0)]
    rim += [points[1:-1, ::-1] for points in rim]
    flat = np.concatenate([*rim, rng.uniform(2.1, 7.9, (count, 2))])
    points = np.column_stack([flat, np.full(len(flat), 4.0)])
    triangles = Delaunay(flat).simplices.astype(np.int64)
    corners = flat[triangles]
    (x, y), (u, v) = (corners[:, 1] - corners[:, 0]).T, (corners[:, 2] - corners[:, 0]).T
    areas = 0.5 * np.abs(x * v - y * u)
    thick = areas > 1e-9
    return points, triangles[thick], LoadedSurface(triangles[thick], areas[thick], len(points))


def traction(points: np.ndarray) -> np.ndarray:
    """A traction that is linear, N/mm^2."""
    x, y = points[:, 0], points[:, 1]
    return np.column_stack([0.01 * x - 0.02, 0.003 * y, -0.02 - 0.004 * x + 0.002 * y])


@pytest.mark.parametrize("count", [30, 300])
def test_a_traction_is_that_of_the_other_mesh_at_any_density(count: int) -> None:
    points, triangles, source = surface(0, count)
    forces = source.mass @ traction(points)
    found = transfer_forces(points, forces, MESH.points, TOP, triangles)
    # Within the loaded square all triangles around a node carry the traction.
    inner = (np.abs(MESH.points[:, :2] - 5.0) < 1.5).all(axis=1) & (MESH.points[:, 2] > 3.9)
    wanted = LoadedSurface(TOP, AREAS, MESH.n_points).mass @ traction(MESH.points)
    np.testing.assert_allclose(found[inner], wanted[inner], rtol=0.02, atol=1e-4)
    at_points = transfer_forces(points, forces, MESH.points, TOP)
    size = np.abs(wanted[inner, 2]).max()
    assert np.abs(at_points - wanted)[inner, 2].max() > 0.1 * size * (30 / count) ** 0.5


@settings(max_examples=15)
@given(seed=st.integers(0, 1000), count=st.integers(1, 60))
def test_sum_and_moment_of_each_set_remain(seed: int, count: int) -> None:
    points, triangles, _ = surface(seed, count)
    points = points + np.random.default_rng(seed).normal(0.0, 0.1, points.shape)
    sets = np.random.default_rng(seed + 1).normal(size=(3, *points.shape))
    found = transfer_forces(points, sets, MESH.points, TOP, triangles)
    np.testing.assert_allclose(found.sum(axis=1), sets.sum(axis=1), atol=1e-8)
    moments = np.cross(points, sets).sum(axis=1)
    np.testing.assert_allclose(np.cross(MESH.points, found).sum(axis=1), moments, atol=1e-6)
    for one, alone in zip(sets, found, strict=True):
        single = transfer_forces(points, one, MESH.points, TOP, triangles)
        np.testing.assert_allclose(alone, single, atol=1e-9)


def test_forces_outside_the_triangles_act_at_points() -> None:
    points, triangles, source = surface(0, 20)
    away = np.concatenate([points, [(1.0, 9.0, 4.0)]])
    forces = np.concatenate([source.mass @ traction(points), [(0.0, 0.1, -1.0)]])
    both = transfer_forces(away, forces, MESH.points, TOP, triangles)
    first = transfer_forces(points, forces[:-1], MESH.points, TOP, triangles)
    second = transfer_forces(away[-1:], forces[-1:], MESH.points, TOP)
    np.testing.assert_allclose(both, first + second, atol=1e-9)

"""Closest points of a triangle surface, against dense sampling."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from tactorch.mesh import box_mesh
from tactorch.mesh.closest import closest_points
from tactorch.mesh.quadrature import lattice

MESH = box_mesh(4.0, 2, tets_per_cell=5)
COORDINATE = st.floats(-3.0, 7.0, allow_nan=False)


@given(st.lists(st.tuples(COORDINATE, COORDINATE, COORDINATE), min_size=1, max_size=5))
@settings(max_examples=30, deadline=None)
def test_no_point_of_the_surface_is_closer(queries) -> None:
    points = np.array(queries)
    triangles = MESH.surface.triangles
    closest = closest_points(MESH.points, triangles, points)
    corners = MESH.points[triangles]
    at = np.einsum("kc,kcd->kd", closest.barycentric, corners[closest.triangles])
    np.testing.assert_allclose(np.linalg.norm(at - points, axis=1), closest.distances, atol=1e-12)
    assert closest.barycentric.min() >= -1e-12
    np.testing.assert_allclose(closest.barycentric.sum(axis=1), 1.0)
    sampled = np.einsum("sc,tcd->tsd", lattice(12, 0.0, corners=3), corners).reshape(-1, 3)
    nearest = np.linalg.norm(sampled[None] - points[:, None], axis=2).min(axis=1)
    assert (closest.distances <= nearest + 1e-9).all()
    assert (closest.distances >= nearest - 0.3).all()


def test_the_box_is_exact() -> None:
    outside = np.array([[2.0, 1.0, 5.5], [-1.0, -1.0, -1.0], [1.0, 2.0, 3.5]])
    closest = closest_points(MESH.points, MESH.surface.triangles, outside)
    np.testing.assert_allclose(closest.distances, [1.5, np.sqrt(3.0), 0.5])


def test_no_queries() -> None:
    closest = closest_points(MESH.points, MESH.surface.triangles, np.zeros((0, 3)))
    assert closest.barycentric.shape == (0, 3)

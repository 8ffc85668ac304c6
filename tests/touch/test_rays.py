"""First points of surfaces along an axis."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import Delaunay
from scipy.spatial.transform import Rotation

from tactorch.mesh import BodyFile, Box, Hemisphere, Shape, Sphere, TetMesh, write_surface
from tactorch.sensor.poses import transform_points
from tactorch.touch.rays import first_hits, surface_heights

FROM_ABOVE = np.diag([1.0, -1.0, -1.0, 1.0])


@pytest.mark.parametrize("shape", [Hemisphere((0.0, 0.0, 0.0), 6.0), Box((0.0, 0.0, 3.0), 6.0)])
def test_heights_are_those_of_the_shape(shape: Shape) -> None:
    rays = np.array([(0.0, 0.0), (1.0, -2.0), (2.9, 0.3), (8.0, 0.0)])
    heights = surface_heights(shape, FROM_ABOVE, rays)
    if isinstance(shape, Box):
        expected = np.array([-6.0, -6.0, -6.0, np.inf])
    else:
        expected = -np.sqrt(np.maximum(36.0 - (rays**2).sum(axis=1), 0.0))
        expected[-1] = np.inf
    np.testing.assert_allclose(heights, expected, atol=1e-6)


def test_lowest_of_two_sheets_is_seen_and_back_sides_are_not() -> None:
    sheet = np.array([(-1.0, -1.0), (1.0, -1.0), (0.0, 2.0)])
    points = np.concatenate([np.column_stack([sheet, np.full(3, z)]) for z in (1.0, 2.0, 0.0)])
    triangles = np.array([(0, 2, 1), (3, 5, 4), (6, 7, 8)])  # the last one faces +z
    hits = first_hits(points, triangles, np.array([(0.0, 0.0), (5.0, 5.0)]))
    assert hits.triangles.tolist() == [0, -1]
    assert hits.z_mm.tolist() == [1.0, np.inf]
    np.testing.assert_allclose(hits.barycentric[0] @ points[triangles[0]], (0, 0, 1), atol=1e-12)


def test_hits_are_the_lowest_of_all_triangles() -> None:
    points, triangles = Hemisphere((0.0, 0.0, 0.0), 6.0, (0.0, 0.0, -1.0)).surface(12)
    rays = np.random.default_rng(0).uniform(-7.0, 7.0, (40, 2))
    hits = first_hits(points, triangles, rays)
    corners = points[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    corners = corners[normals[:, 2] < -0.2 * np.linalg.norm(normals, axis=1)]
    systems = np.concatenate(
        [np.moveaxis(corners[..., :2], 1, 2), np.ones((len(corners), 1, 3))], 1
    )
    for ray, z in zip(rays, hits.z_mm, strict=True):
        shares = np.linalg.solve(systems, np.array([*ray, 1.0])[None, :, None])[..., 0]
        heights = (shares * corners[..., 2]).sum(axis=1)[(shares >= 0.0).all(axis=1)]
        assert z == pytest.approx(heights.min(initial=np.inf))
    assert 10 < np.isfinite(hits.z_mm).sum() < 40
    met = hits.triangles >= 0
    corners = points[triangles[hits.triangles[met]]]
    found = np.einsum("qc,qcd->qd", hits.barycentric[met], corners)
    np.testing.assert_allclose(found, np.column_stack([rays, hits.z_mm])[met], atol=1e-12)


def test_bodies_of_files_are_their_triangles(tmp_path: Path) -> None:
    path = tmp_path / "dome.stl"
    write_surface(path, *Hemisphere((0.0, 0.0, 0.0), 6.0).surface(24))
    rays = np.array([(0.1, 0.2), (2.0, 1.0)])
    exact = surface_heights(Hemisphere((0.0, 0.0, 0.0), 6.0), FROM_ABOVE, rays)
    found = surface_heights(BodyFile(str(path)), FROM_ABOVE, rays)
    assert (found >= exact - 1e-5).all()  # the polyhedron is inside the hemisphere
    np.testing.assert_allclose(found, exact, atol=0.1)


def test_surface_of_a_mesh_is_curved_between_its_nodes() -> None:
    """A ball of few nodes, seen from any side: its triangles are up to 0.3 mm inside it."""
    count = np.arange(300) + 0.5
    polar, turn = np.arccos(1.0 - count / 150.0), np.pi * (1.0 + 5.0**0.5) * count
    ring = np.column_stack([np.cos(turn), np.sin(turn)]) * np.sin(polar)[:, None]
    nodes = np.concatenate([30.0 * np.column_stack([ring, np.cos(polar)]), np.zeros((1, 3))])
    mesh = TetMesh.create(nodes, Delaunay(nodes).simplices)
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("xyz", (160.0, 25.0, 40.0), degrees=True).as_matrix()
    pose[:3, 3] = -40.0 * pose[:3, 2]
    rays = np.random.default_rng(0).uniform(-8.0, 8.0, (400, 2))
    exact = surface_heights(Sphere((0.0, 0.0, 0.0), 30.0), pose, rays)
    points = transform_points(np.linalg.inv(pose), mesh.points)
    flat = first_hits(points, mesh.surface.triangles, rays).z_mm - exact
    curved = surface_heights(mesh, pose, rays) - exact
    assert flat.max() > 0.25
    assert np.abs(curved).max() < 0.1 * flat.max()

"""Meshes of shapes by a lattice."""

import numpy as np
import pytest

from tactorch.errors import ConfigError, MeshError
from tactorch.mesh import Box, Cylinder, Hemisphere, Hyperboloid, Lathe, Shape
from tactorch.mesh.geometry import enclosed_volume
from tactorch.mesh.lattice import lattice_mesh

SHAPES = [
    Box((0.0, 0.0, 4.0), (10.0, 9.0, 8.0)),
    Cylinder((0.0, 0.0, 5.0), 6.0, 10.0),
    Hemisphere((0.0, 0.0, 0.0), 8.0),
    Hyperboloid((0.0, 0.0, 6.0), 5.0, 7.0, 12.0),
    Lathe((0.0, 0.0, 0.0), [(0, 0), (5, 0), (7, 4), (6, 8), (3, 10), (0, 11)]),
]


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: type(shape).__name__)
def test_mesh_fills_the_shape_and_stands_on_its_base(shape: Shape) -> None:
    mesh = lattice_mesh(shape, 2.0)
    assert mesh.volumes.sum() == pytest.approx(enclosed_volume(*shape.surface()), rel=0.06)
    surface = mesh.points[np.unique(mesh.surface.triangles)]
    assert np.abs(shape.signed_distance(surface)).max() < 0.5
    base = mesh.surface.normals[:, 2] < -0.999
    flat = mesh.points[mesh.surface.triangles[base]][:, :, 2]
    assert (flat == shape.bounds()[0, 2]).all(axis=1).sum() > 10
    np.testing.assert_allclose(mesh.bounds, shape.bounds(), atol=1e-9)
    assert mesh.volumes.min() > 5e-4 * np.median(mesh.volumes)


def test_same_shape_has_the_same_mesh_and_edges_of_the_wanted_length() -> None:
    shape = SHAPES[2]
    meshes = [lattice_mesh(shape, edge) for edge in (1.5, 1.5, 3.0)]
    assert meshes[0].content_hash() == meshes[1].content_hash()
    for mesh, edge in zip(meshes[1:], (1.5, 3.0), strict=True):
        ends = mesh.points[mesh.edges]
        assert np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).mean() == pytest.approx(
            edge, rel=0.2
        )


def test_edges_that_cannot_be_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"would take .* cells .*choose a larger one"):
        lattice_mesh(SHAPES[0], 0.01)
    profile = [(0, 0), (4, 0), (4, 3), (0.05, 4), (0.05, 9), (4, 10), (4, 13), (0, 13)]
    neck = Lathe((0.0, 0.0, 0.0), profile)
    with pytest.raises(MeshError, match="cannot be meshed with edges of 2 mm"):
        lattice_mesh(neck, 2.0)

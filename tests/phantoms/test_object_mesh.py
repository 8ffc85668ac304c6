"""Meshes whose faces follow inclusions, and moduli at quadrature points."""

import numpy as np
import pytest

from tactorch.fem.elements import TET10
from tactorch.mesh import Box, Cylinder, Shape, Sphere, TetMesh, Torus
from tactorch.mesh.refine import edge_lengths
from tactorch.phantoms import MeshSize, Phantom, make_phantom
from tactorch.phantoms.object_mesh import follow_inclusions

CUBE = Box((5.0,) * 3, (10.0, 10.0, 10.0))
BALL = Sphere((5.0, 5.0, 6.0), 2.0)


def inside(mesh: TetMesh, shape: Shape) -> np.ndarray:
    return shape.contains(mesh.centroids)


@pytest.mark.parametrize(
    ("shape", "volume"),
    [(BALL, 4 / 3 * np.pi * 8), (Torus((5.0, 5.0, 5.0), 2.5, 1.0), 2 * np.pi**2 * 2.5)],
)
def test_faces_follow_a_smooth_inclusion(shape: Shape, volume: float) -> None:
    start = Phantom(CUBE).mesh(relative_edge_length=0.055)
    mesh = follow_inclusions(start, [shape])
    assert mesh.volumes.min() > 0.0
    assert mesh.volumes.sum() == pytest.approx(1000.0)
    part = inside(mesh, shape)
    assert mesh.volumes[part].sum() == pytest.approx(volume, rel=1e-2)
    rim = np.intersect1d(mesh.tets[part], mesh.tets[~part])
    assert np.abs(shape.signed_distance(mesh.points[rim])).max() < 0.08
    planes = np.minimum(mesh.points, 10.0 - mesh.points)[np.unique(mesh.surface.triangles)]
    assert np.abs(planes.min(axis=1)).max() < 1e-12


def test_small_inclusions_have_short_edges() -> None:
    start = Phantom(CUBE).mesh(relative_edge_length=0.1)
    small = Sphere((5.0, 5.0, 6.0), 0.5)
    mesh = follow_inclusions(start, [small, Sphere((2.0, 2.0, 2.0), 1.5)])
    assert inside(start, small).sum() < 5
    part = inside(mesh, small)
    assert part.sum() > 20
    assert edge_lengths(mesh.points, mesh.tets[part]).max() < 1.0
    assert mesh.volumes[part].sum() == pytest.approx(np.pi / 6, rel=0.1)


def test_meshes_without_inclusions_remain() -> None:
    uniform = Phantom(CUBE)
    mesh = uniform.mesh()
    assert follow_inclusions(mesh, []) is mesh
    fine = MeshSize().build(uniform)[1]
    assert fine is not None
    assert fine.content_hash() == uniform.mesh(relative_edge_length=0.06).content_hash()


def test_meshes_do_not_follow_where_that_is_switched_off() -> None:
    phantom = make_phantom("cube_sphere")
    fine = MeshSize(fine_conforming=False).build(phantom)[1]
    assert fine is not None
    assert fine.content_hash() == phantom.mesh(relative_edge_length=0.06).content_hash()


def test_the_mean_of_the_moduli_is_that_of_the_object() -> None:
    rod = Cylinder((5.0, 5.0, 5.0), 2.0, 4.0)
    phantom = Phantom(CUBE, [(rod, 1.0)], 0.2)
    mesh = phantom.mesh(relative_edge_length=0.1)
    moduli = phantom.at_quadrature(mesh, TET10.points)
    assert moduli.shape == (mesh.n_tets, 4)
    part = 16.0 * np.pi / 1000.0
    mean = np.average(np.log(moduli), axis=0, weights=mesh.volumes).mean()
    np.testing.assert_allclose(mean, (1.0 - part) * np.log(0.2), rtol=5e-3)
    whole = np.ptp(moduli, axis=1) < 1e-12
    np.testing.assert_allclose(moduli[whole, 0], phantom.youngs_at(mesh.centroids[whole]))
    assert 20 < (~whole).sum() < 0.5 * mesh.n_tets


def test_moduli_are_those_around_each_quadrature_point() -> None:
    """The interface leaves the upper corner of an element in the stiff half."""
    phantom = Phantom(
        Box((0.5,) * 3, (1.0,) * 3), [(Box((0.5, 0.5, 0.75), (1.0, 1.0, 0.5)), 1.0)], 0.2
    )
    mesh = phantom.mesh(1.0)
    moduli = phantom.at_quadrature(mesh, TET10.points)
    heights = np.einsum("qc,mcd->mqd", TET10.points, mesh.points[mesh.tets])[..., 2]
    assert np.corrcoef(heights.ravel(), moduli.ravel())[0, 1] > 0.8

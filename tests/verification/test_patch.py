"""Patch test: a linear displacement on the boundary is reproduced inside, on a distorted mesh."""

import numpy as np
import pytest

from tactorch.fem import ELEMENTS, MATERIALS, SoftBody, Supports, make_material
from tactorch.mesh import TetMesh, box_mesh

GRADIENT = np.array([[0.10, 0.08, -0.03], [-0.05, -0.12, 0.06], [0.04, 0.02, 0.15]])


@pytest.fixture(scope="module")
def distorted():
    """A block whose inner nodes are far off the grid, and which nodes are on its boundary."""
    grid = box_mesh((3.0, 2.0, 2.5), (3, 3, 3), tets_per_cell=5)
    inner = np.ones(grid.n_points, dtype=bool)
    inner[grid.surface.nodes()] = False
    noise = np.random.default_rng(0).uniform(-0.2, 0.2, grid.points.shape)
    assert inner.sum() == 8
    return TetMesh(grid.points + inner[:, None] * noise, grid.tets), ~inner


@pytest.mark.parametrize("material", MATERIALS.names())
@pytest.mark.parametrize("element", ELEMENTS.names())
def test_linear_displacements_are_reproduced(material, element, distorted):
    mesh, boundary = distorted
    body = SoftBody(mesh, make_material(material, 0.45), element=element)
    positions = body.discretisation.positions
    expected = positions @ GRADIENT.T
    supports = Supports(
        fixed=np.repeat(boundary[:, None], 3, axis=1), prescribed=mesh.points @ GRADIENT.T
    )
    found = body.equilibrate(np.ones(mesh.n_tets), np.zeros((mesh.n_points, 3)), supports)
    assert found.converged, found.reason
    np.testing.assert_allclose(found.displacement, expected, rtol=0, atol=1e-10)
    deformation = np.broadcast_to(np.eye(3) + GRADIENT, found.response.F.shape)
    np.testing.assert_allclose(found.response.F, deformation, rtol=0, atol=1e-10)


@pytest.mark.parametrize("material", [m for m in MATERIALS.names() if m != "linear"])
@pytest.mark.parametrize("element", ELEMENTS.names())
def test_rigid_motions_cost_nothing(material, element, distorted):
    """A rotated body has no energy and no forces, whatever the angle."""
    mesh, _ = distorted
    body = SoftBody(mesh, make_material(material, 0.45), element=element)
    c, s = np.cos(0.7), np.sin(0.7)
    Q = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    positions = body.discretisation.positions
    response = body.assembly.respond(positions @ Q.T - positions + [1.0, 2.0, 3.0])
    assert np.abs(response.energy).max() < 1e-13
    assert np.abs(response.forces).max() < 1e-13


@pytest.mark.parametrize("element", ELEMENTS.names())
def test_the_tangent_at_rest_knows_six_rigid_modes(element, distorted):
    mesh, _ = distorted
    body = SoftBody(mesh, make_material("neo_hookean", 0.45), element=element)
    d = body.discretisation
    rest = body.assembly.respond(np.zeros((d.n_nodes, 3)))
    tangent = d.pattern.full(body.assembly.tangent(rest, np.ones(mesh.n_tets))).toarray()
    np.testing.assert_allclose(tangent @ d.rigid_modes, 0.0, atol=1e-12)
    values = np.linalg.eigvalsh(tangent)
    assert np.count_nonzero(np.abs(values) < 1e-10) == 6
    assert values.min() > -1e-10

"""Nodal forces of pressures, tractions and gravity."""

import inspect

import numpy as np
import pytest
import torch
from torch.autograd import gradcheck

from tactorch.errors import ConfigError, MeshError
from tactorch.fem import ELEMENTS, STANDARD_GRAVITY, SoftBody, make_material
from tactorch.mesh import TetMesh, box_mesh, select_face
from tactorch.simulation import simulate

FACES = {"x-": (0, -1), "x+": (0, 1), "y-": (1, -1), "y+": (1, 1), "z-": (2, -1), "z+": (2, 1)}


@pytest.fixture(scope="module")
def slab():
    """6 x 4 x 2 mm, inner nodes and face nodes off the grid."""
    grid = box_mesh((6.0, 4.0, 2.0), (3, 3, 2))
    rng = np.random.default_rng(0)
    free = (grid.points > 0) & (grid.points < [6.0, 4.0, 2.0])  # corners and edges keep the box
    return TetMesh(grid.points + free * rng.uniform(-0.1, 0.1, free.shape), grid.tets)


@pytest.fixture(params=ELEMENTS.names())
def body(request, slab):
    return SoftBody(slab, make_material("neo_hookean", 0.45), element=request.param)


@pytest.mark.parametrize("face", FACES)
def test_a_pressure_pushes_inward_with_its_area(body, face):
    axis, side = FACES[face]
    area = np.delete([6.0, 4.0, 2.0], axis).prod()
    forces = body.pressure(face, 0.02)
    expected = torch.zeros(3, dtype=torch.float64)
    expected[axis] = -side * 0.02 * area
    torch.testing.assert_close(forces.sum(0), expected, rtol=1e-12, atol=1e-14)


def test_a_pressure_acts_through_the_centre_of_its_face(body):
    forces = body.pressure("z+", 0.02).numpy()
    x = body.discretisation.positions
    centre = (forces[:, 2, None] * x).sum(0) / forces[:, 2].sum()
    np.testing.assert_allclose(centre, [3.0, 2.0, 2.0], atol=1e-12)


def test_forces_stay_on_the_face(body):
    forces = body.pressure("x-", 0.02).numpy()
    off = body.discretisation.positions[:, 0] > 1e-12
    assert np.all(forces[off] == 0.0)


def test_a_traction_has_its_own_direction(body):
    forces = body.traction("y+", [0.01, -0.02, 0.03])
    expected = torch.tensor([0.01, -0.02, 0.03], dtype=torch.float64) * 12.0
    torch.testing.assert_close(forces.sum(0), expected, rtol=1e-12, atol=0)


def test_a_pressure_on_all_sides_is_in_balance(body, slab):
    everywhere = np.arange(len(slab.surface.triangles))
    forces = body.pressure(everywhere, 0.1).numpy()
    np.testing.assert_allclose(forces.sum(0), 0.0, atol=1e-13)
    moment = np.cross(body.discretisation.positions, forces).sum(0)
    np.testing.assert_allclose(moment, 0.0, atol=1e-12)


def test_triangles_may_be_chosen_by_index(body, slab):
    chosen = select_face(slab, "z+")
    torch.testing.assert_close(body.pressure(chosen, 0.1), body.pressure("z+", 0.1))
    half = body.pressure(chosen[::2], 0.1) + body.pressure(chosen[1::2], 0.1)
    torch.testing.assert_close(half, body.pressure("z+", 0.1))


def test_gravity_weighs_what_the_body_weighs(body):
    density, g = 1.07e-9, (100.0, 0.0, -9810.0)
    weight = body.gravity(density, g)
    expected = torch.tensor(g, dtype=torch.float64) * density * 48.0
    torch.testing.assert_close(weight.sum(0), expected, rtol=1e-13, atol=0)


def test_standard_gravity_is_one_constant(body):
    """9.80665 m/s^2 (CGPM 1901), for bodies as for simulated recordings."""
    weight = float(body.gravity(1.07e-9)[:, 2].sum())
    assert weight == pytest.approx(-1.07e-9 * 9806.65 * 48.0, rel=1e-12)
    assert inspect.signature(simulate).parameters["gravity"].default is STANDARD_GRAVITY


def test_gravity_acts_at_the_centre_of_mass(body):
    forces = body.gravity(1e-9).numpy()
    x = body.discretisation.positions
    centre = (forces[:, 2, None] * x).sum(0) / forces[:, 2].sum()
    np.testing.assert_allclose(centre, [3.0, 2.0, 1.0], atol=1e-12)


def test_gravity_is_consistent_with_the_shape_functions(slab):
    """The work of nodal weights on a quadratic field is the integral of the field."""
    body = SoftBody(slab, make_material("neo_hookean", 0.45), element="tet10")
    forces = body.gravity(1.0, (0.0, 0.0, 1.0)).numpy()[:, 2]
    x = body.discretisation.positions
    # The integral of x^2 over the box, and of x y.
    assert forces @ x[:, 0] ** 2 == pytest.approx(6.0**3 / 3 * 8.0, rel=1e-12)
    assert forces @ (x[:, 0] * x[:, 1]) == pytest.approx(18.0 * 8.0 * 2.0, rel=1e-12)


def test_tractions_are_consistent_with_the_shape_functions(slab):
    body = SoftBody(slab, make_material("neo_hookean", 0.45), element="tet10")
    forces = body.traction("z+", [1.0, 0.0, 0.0]).numpy()[:, 0]
    x = body.discretisation.positions
    assert forces @ x[:, 0] ** 2 == pytest.approx(6.0**3 / 3 * 4.0, rel=1e-12)


@pytest.mark.parametrize("element", ELEMENTS.names())
def test_loads_are_differentiable_in_the_rest_shape(element, cell):
    body = cell("neo_hookean", element).body
    triangles = np.array([0, 3, 5])
    points = torch.tensor(body.mesh.points, requires_grad=True)
    pressure = torch.tensor(0.1, dtype=torch.float64, requires_grad=True)
    assert gradcheck(lambda x, p: body.pressure(triangles, p, x), (points, pressure))
    traction = torch.tensor([0.1, 0.2, -0.1], dtype=torch.float64, requires_grad=True)
    assert gradcheck(lambda x, t: body.traction(triangles, t, x), (points, traction))
    assert gradcheck(lambda x: body.gravity(1e-3, (0.0, 0.0, -9.0), x), points)


def test_unknown_faces_are_refused(body):
    with pytest.raises(ConfigError, match=r"'top'.*z\+"):
        body.pressure("top", 0.1)


@pytest.mark.parametrize("chosen", [[], [-1], [10_000]])
def test_triangles_that_are_not_there_are_refused(body, chosen):
    with pytest.raises(ConfigError, match=r"selects no triangle or one outside"):
        body.pressure(np.array(chosen, dtype=np.int64), 0.1)


def test_round_sides_are_refused():
    corner = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    body = SoftBody(TetMesh.create(corner, np.array([[0, 1, 2, 3]])), make_material("linear", 0.3))
    with pytest.raises(MeshError, match=r"No boundary triangle is on side 'x\+'"):
        body.pressure("x+", 0.1)

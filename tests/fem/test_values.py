"""Derivative order zero: what `solve` returns is an equilibrium."""

import numpy as np
import pytest
import torch

from tactorch.errors import ConfigError
from tactorch.fem import ELEMENTS, MATERIALS, SoftBody, Supports, make_material
from tactorch.mesh import TetMesh


@pytest.fixture(params=ELEMENTS.names())
def element(request):
    return request.param


@pytest.fixture(params=MATERIALS.names())
def name(request):
    return request.param


def test_the_energy_is_stationary_and_lowest(name, element, cell):
    c = cell(name, element)
    u = c.solve()
    for case in range(2):
        at = u[case].clone().requires_grad_(True)
        energy = c.energy(at, case)
        (slope,) = torch.autograd.grad(energy, at)
        assert slope.abs().max() < 1e-9 * c.inputs["forces"][case].abs().max()
        for _ in range(5):
            step = 0.02 * torch.randn_like(at)
            assert c.energy(u[case] + step, case) > energy


def test_a_batch_is_its_cases_one_by_one(name, element, cell):
    c = cell(name, element)
    singles = [c.solve(forces=f) for f in c.inputs["forces"]]
    assert singles[0].ndim == 2
    torch.testing.assert_close(c.solve(), torch.stack(singles), rtol=0, atol=1e-12)


def test_cases_may_be_held_each_in_its_own_way(cell, clamped):
    c = cell("neo_hookean", "tet4")
    springs = np.stack([c.supports.springs, 3.0 * c.supports.springs])
    e, f = c.inputs["youngs"], c.inputs["forces"]
    both = c.body.solve(e, f, Supports(springs=springs))
    for i in range(2):
        alone = c.body.solve(e, f[i], Supports(springs=springs[i]))
        torch.testing.assert_close(both[i], alone, rtol=0, atol=1e-12)


def test_springs_at_all_nodes_are_used_as_they_are(cell):
    discretisation = cell("neo_hookean", "tet10").body.discretisation
    springs = np.arange(3.0 * discretisation.n_nodes).reshape(-1, 3)
    np.testing.assert_array_equal(
        Supports(springs=springs).case(0, discretisation).springs, springs
    )
    with pytest.raises(ConfigError, match=r"supports\.springs has shape"):
        Supports(springs=springs[1:]).case(0, discretisation)
    with pytest.raises(ConfigError, match=r"supports\.fixed has shape"):
        Supports(fixed=springs > 0).case(0, discretisation)


def test_doubling_moduli_springs_and_forces_changes_nothing(name, element, cell):
    c = cell(name, element)
    twice = c.body.solve(
        2.0 * c.inputs["youngs"],
        2.0 * c.inputs["forces"],
        Supports(springs=2.0 * c.supports.springs),
    )
    torch.testing.assert_close(twice, c.solve(), rtol=0, atol=1e-11)


def test_rest_shape_given_as_points_is_the_body_of_that_mesh(name, element, cell):
    c = cell(name, element)
    moved = c.inputs["points"] + 0.03 * torch.randn_like(c.inputs["points"])
    mesh = TetMesh(moved.numpy(), c.body.mesh.tets)
    other = SoftBody(mesh, c.body.material, element=element)
    e, f, held = c.inputs["youngs"], c.inputs["forces"], Supports(fixed=c.supports.springs > 0)
    found = c.body.solve(e, f, held, points=moved)
    torch.testing.assert_close(found, other.solve(e, f, held), rtol=0, atol=1e-11)


def test_poisson_given_is_the_body_of_that_material(name, element, cell):
    c = cell(name, element)
    nu = torch.tensor(0.3, dtype=torch.float64)
    other = SoftBody(c.body.mesh, make_material(name, 0.3), element=element)
    expected = other.solve(c.inputs["youngs"], c.inputs["forces"], c.supports)
    torch.testing.assert_close(c.solve(poisson=nu), expected, rtol=0, atol=1e-11)
    each = nu.expand(c.body.mesh.n_tets).clone()
    torch.testing.assert_close(c.solve(poisson=each), expected, rtol=0, atol=1e-11)


def test_a_warm_start_leads_to_the_same_place(element, cell):
    c = cell("neo_hookean", element)
    cold = c.solve()
    start = cold.numpy() + 0.02 * np.random.default_rng(0).standard_normal(cold.shape)
    warm = c.body.solve(c.inputs["youngs"], c.inputs["forces"], c.supports, start=start)
    torch.testing.assert_close(warm, cold, rtol=0, atol=1e-9)
    one = c.body.solve(c.inputs["youngs"], c.inputs["forces"][1], c.supports, start=start[1])
    torch.testing.assert_close(one, cold[1], rtol=0, atol=1e-9)

"""What a soft body refuses, and how it tells."""

import numpy as np
import pytest
import torch
from torch.autograd import gradcheck, gradgradcheck

from tactorch.errors import ConfigError, ConvergenceError
from tactorch.fem import SoftBody, Supports, make_material


@pytest.fixture
def body(block):
    return SoftBody(block, make_material("neo_hookean", 0.45))


@pytest.fixture
def held(block, clamped):
    return Supports(fixed=clamped(block, "z-"))


@pytest.fixture
def youngs(block):
    return torch.ones(block.n_tets, dtype=torch.float64)


@pytest.fixture
def forces(body):
    return body.pressure("z+", 0.01)


def test_unknown_elements_are_refused_with_the_choices(block):
    with pytest.raises(ConfigError, match="element=hex8 is unknown; choose one of tet4, tet10"):
        SoftBody(block, make_material("linear", 0.3), element="hex8")


def test_unknown_solvers_are_refused_at_first_use(block, held, youngs):
    body = SoftBody(block, make_material("linear", 0.3), solver="mumps")
    with pytest.raises(ConfigError, match=r"solver=mumps is unknown"):
        body.solve(youngs, body.pressure("z+", 0.01), held)


@pytest.mark.parametrize("bad", [0.0, -1.0, float("nan"), float("inf")])
def test_moduli_must_be_positive(body, held, youngs, forces, bad):
    youngs[7] = bad
    with pytest.raises(ConfigError, match=r"youngs\[7\] = .*MPa.*finite and positive"):
        body.solve(youngs, forces, held)


def test_moduli_must_be_as_many_as_the_elements(body, held, youngs, forces, block):
    with pytest.raises(ConfigError, match=rf"youngs has shape.*{block.n_tets} elements"):
        body.solve(youngs[1:], forces, held)
    with pytest.raises(ConfigError, match=rf"youngs has shape.*{block.n_tets} elements"):
        body.equilibrate(youngs[1:].numpy(), forces.numpy(), held)


@pytest.mark.parametrize("element", ["tet4", "tet10"])
@pytest.mark.parametrize("extra", [-1, 1])
def test_forces_must_be_one_a_node(block, held, youngs, element, extra):
    body = SoftBody(block, make_material("neo_hookean", 0.45), element=element)
    wrong = torch.zeros(block.n_points + extra, 3, dtype=torch.float64)
    with pytest.raises(ConfigError, match=rf"forces have shape.*\({block.n_points}, 3\)"):
        body.solve(youngs, wrong, held)
    with pytest.raises(ConfigError, match=rf"forces have shape.*\({block.n_points}, 3\)"):
        body.equilibrate(youngs.numpy(), wrong.numpy(), held)


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_forces_must_be_finite(body, held, youngs, forces, bad):
    forces[3, 1] = bad
    with pytest.raises(ConfigError, match=r"forces contain NaN or infinity"):
        body.solve(youngs, forces, held)
    with pytest.raises(ConfigError, match=r"forces contain NaN or infinity"):
        body.equilibrate(youngs.numpy(), forces.numpy(), held)


@pytest.mark.parametrize("name", ["youngs", "forces", "poisson", "points"])
def test_single_precision_is_refused_by_name(body, held, youngs, forces, block, name):
    inputs = {
        "youngs": youngs,
        "forces": forces,
        "poisson": torch.tensor(0.45, dtype=torch.float64),
        "points": torch.tensor(block.points),
    }
    inputs[name] = inputs[name].float()
    with pytest.raises(ConfigError, match=rf"{name} is torch.float32.*float64"):
        body.solve(
            inputs["youngs"],
            inputs["forces"],
            held,
            poisson=inputs["poisson"],
            points=inputs["points"],
        )


@pytest.mark.parametrize("bad", [0.5, 0.6, -1.0, float("nan")])
def test_poisson_given_must_be_possible(body, held, youngs, forces, bad):
    with pytest.raises(ConfigError, match="poisson"):
        body.solve(youngs, forces, held, poisson=torch.tensor(bad, dtype=torch.float64))


def test_poisson_given_must_be_one_or_one_an_element(body, held, youngs, forces):
    with pytest.raises(ConfigError, match="poisson"):
        body.solve(youngs, forces, held, poisson=torch.full((3,), 0.4, dtype=torch.float64))


def test_a_rest_shape_turned_inside_out_is_refused(body, held, youngs, forces, block):
    points = torch.tensor(block.points) * torch.tensor([1.0, 1.0, -1.0], dtype=torch.float64)
    with pytest.raises(ConfigError, match="points"):
        body.solve(youngs, forces, held, points=points)


def test_a_rest_shape_of_another_mesh_is_refused(body, held, youngs, forces, block):
    with pytest.raises(ConfigError, match="points"):
        body.solve(youngs, forces, held, points=torch.tensor(block.points[1:]))


def test_too_many_dimensions_are_refused(body, held, youngs, forces):
    with pytest.raises(ConfigError, match="forces have 4 dimensions"):
        body.solve(youngs, forces[None, None], held)


def test_a_case_that_fails_fails_the_batch_by_its_reason(body, youngs, forces):
    with pytest.raises(ConvergenceError, match="Nothing holds the object"):
        body.solve(youngs, torch.stack([forces, forces]), Supports())


def test_nodes_of_the_quadratic_element_follow_the_vertices(block):
    body = SoftBody(block, make_material("linear", 0.3), element="tet10")
    d = body.discretisation
    assert body.n_nodes == block.n_points + len(block.edges)
    np.testing.assert_array_equal(d.positions[: block.n_points], block.points)
    middles = block.points[block.edges].mean(1)
    np.testing.assert_allclose(
        np.unique(d.positions[block.n_points :], axis=0), np.unique(middles, axis=0), atol=1e-12
    )


def test_vertex_forces_of_the_quadratic_element_are_differentiable(block, held, youngs):
    body = SoftBody(block, make_material("linear", 0.3), element="tet10")
    covered = SoftBody(block, make_material("linear", 0.3)).pressure("z+", 0.01)
    nodes = np.flatnonzero(covered.abs().sum(1))

    mixed = torch.randn(2, body.n_nodes * 3, dtype=torch.float64)

    def solve(values):
        """Two combinations of all displacements: each output costs solves for its gradient."""
        forces = covered.clone()
        forces[nodes[:2]] = values
        return mixed @ body.solve(youngs, forces, held).ravel()

    values = covered[nodes[:2]].clone().requires_grad_()
    assert gradcheck(solve, values, check_forward_ad=True)
    assert gradgradcheck(solve, values)


def test_vertex_forces_serve_the_quadratic_element(block, held, youngs):
    """Point loads stay; loads that cover a face become the consistent ones of its midsides."""
    body = SoftBody(block, make_material("linear", 0.3), element="tet10")
    linear = SoftBody(block, make_material("linear", 0.3))
    point = torch.zeros(block.n_points, 3, dtype=torch.float64)
    point[-1, 2] = -0.1
    padded = torch.zeros(body.n_nodes, 3, dtype=torch.float64)
    padded[: block.n_points] = point
    torch.testing.assert_close(body.solve(youngs, point, held), body.solve(youngs, padded, held))
    pressed = body.solve(youngs, linear.pressure("z+", 0.01), held)
    torch.testing.assert_close(
        pressed, body.solve(youngs, body.pressure("z+", 0.01), held), rtol=0, atol=1e-12
    )

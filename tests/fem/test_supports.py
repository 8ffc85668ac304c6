import numpy as np
import pytest
import torch

from tactorch.errors import ConfigError
from tactorch.fem import ELEMENTS, SoftBody, Supports, make_material


@pytest.fixture(params=ELEMENTS.names())
def body(request, block):
    return SoftBody(block, make_material("neo_hookean", 0.45), element=request.param)


def test_midsides_are_held_where_both_ends_are(body, block, clamped):
    fixed = clamped(block, "z-")
    prescribed = np.where(fixed, block.points, 0.0)
    held = Supports(fixed=fixed, prescribed=prescribed).case(0, body.discretisation)
    positions = body.discretisation.positions
    on_face = positions[:, 2] == 0.0
    np.testing.assert_array_equal(held.fixed, on_face[:, None].repeat(3, axis=1))
    expected = np.where(held.fixed, positions, 0.0)
    np.testing.assert_allclose(held.prescribed, expected, atol=1e-14)


def test_values_at_free_unknowns_are_ignored(body, block, clamped):
    fixed = clamped(block, "z-")
    noise = np.random.default_rng(0).standard_normal(fixed.shape)
    held = Supports(fixed=fixed, prescribed=noise).case(0, body.discretisation)
    assert np.all(held.prescribed[~held.fixed] == 0.0)
    np.testing.assert_array_equal(held.prescribed[: block.n_points][fixed], noise[fixed])


def test_springs_of_a_face_keep_their_total_and_stay_on_it(body, block, clamped):
    springs = 2.0 * clamped(block, "z-")
    held = Supports(springs=springs).case(0, body.discretisation)
    np.testing.assert_allclose(held.springs.sum(0), springs.sum(0), rtol=1e-13)
    assert np.all(held.springs[body.discretisation.positions[:, 2] > 0] == 0.0)
    assert np.all(held.springs >= 0.0)


def test_springs_at_single_vertices_stay_there(body, block):
    springs = np.zeros((block.n_points, 3))
    springs[[0, 17, 40]] = 2.0
    held = Supports(springs=springs).case(0, body.discretisation)
    np.testing.assert_array_equal(held.springs[: block.n_points], springs)
    assert np.all(held.springs[block.n_points :] == 0.0)


def test_one_support_serves_every_case_and_stacked_ones_their_own(body, block):
    one = np.ones((block.n_points, 3))
    d = body.discretisation
    assert Supports(springs=one).case(5, d).springs.max() == 1.0
    stacked = Supports(springs=np.stack([one, 2.0 * one]))
    assert [stacked.case(i, d).springs.max() for i in (0, 1)] == [1.0, 2.0]


def test_stiff_springs_tend_to_exact_supports(body, block, clamped):
    fixed = clamped(block, "z-")
    youngs = np.ones(block.n_tets)
    forces = body.traction("z+", [0.02, 0.0, -0.05]).numpy()
    exact = body.equilibrate(youngs, forces, Supports(fixed=fixed)).displacement
    above = body.discretisation.positions[:, 2] > 3.0
    gaps = []
    for stiffness in (1e3, 1e4):
        found = body.equilibrate(youngs, forces, Supports(springs=stiffness * fixed))
        gaps.append(np.abs(found.displacement - exact)[above].max())
    assert gaps[1] < 0.05 * np.abs(exact).max()
    if not body.discretisation.element.quadratic:  # there corners of the face stay free
        assert gaps[0] / gaps[1] == pytest.approx(10.0, rel=0.05)


def test_springs_carry_the_load(body, block, clamped):
    """In balance the springs' forces add up to the load: k u = f, summed."""
    springs = 0.7 * clamped(block, "z-")
    forces = body.traction("z+", [0.004, 0.0, -0.01])
    youngs = torch.ones(block.n_tets, dtype=torch.float64)
    u = body.solve(youngs, forces, Supports(springs=springs)).numpy()
    held = Supports(springs=springs).case(0, body.discretisation)
    carried = (held.springs * u).sum(0)
    np.testing.assert_allclose(carried, forces.sum(0), atol=1e-9)


@pytest.mark.parametrize("bad", [-1.0, np.nan, np.inf])
def test_springs_that_cannot_be_are_refused(body, block, bad):
    springs = np.ones((block.n_points, 3))
    springs[3, 1] = bad
    with pytest.raises(ConfigError, match=r"supports\.springs.*N/mm"):
        Supports(springs=springs).case(0, body.discretisation)


@pytest.mark.parametrize("field", ["fixed", "prescribed", "springs"])
def test_arrays_of_another_mesh_are_refused(body, block, field):
    kind = bool if field == "fixed" else float
    values = np.ones((block.n_points - 1, 3), dtype=kind)
    with pytest.raises(
        ConfigError, match=rf"supports\.{field} has shape.*{block.n_points}"
    ) as error:
        Supports(**{field: values}).case(0, body.discretisation)
    at_all_nodes = f"or all {body.n_nodes} element nodes" in str(error.value)
    assert at_all_nodes == (field == "springs")


def test_prescribed_values_must_be_finite(body, block, clamped):
    fixed = clamped(block, "z-")
    prescribed = np.zeros(fixed.shape)
    prescribed[fixed] = np.nan
    with pytest.raises(ConfigError, match=r"supports\.prescribed"):
        Supports(fixed=fixed, prescribed=prescribed).case(0, body.discretisation)


@pytest.mark.parametrize("cases", [1, 3])
def test_stacked_supports_must_be_as_many_as_the_cases(body, block, clamped, cases):
    fixed = np.stack([clamped(block, "z-")] * 2)
    forces = torch.zeros(cases, body.n_nodes, 3, dtype=torch.float64)
    youngs = torch.ones(block.n_tets, dtype=torch.float64)
    with pytest.raises(ConfigError, match=r"cases"):
        body.solve(youngs, forces, Supports(fixed=fixed))

"""The tangent at an equilibrium: exact answers, however old the factorisation."""

import numpy as np
import pytest

from tactorch.errors import ConvergenceError
from tactorch.fem import SoftBody, Supports, make_material
from tactorch.fem.linearization import Linearization


@pytest.fixture
def search(block, clamped):
    body = SoftBody(block, make_material("neo_hookean", 0.45))
    forces = body.pressure("z+", 0.1).numpy()
    return body.search(np.ones(block.n_tets), forces, Supports(fixed=clamped(block, "z-")))


def exact(linearization, rhs):
    """Solve with the dense free part of the tangent."""
    free = ~linearization.fixed
    dense = linearization.pattern.full(linearization.values).toarray()
    out = np.zeros_like(rhs)
    out[free] = np.linalg.solve(dense[np.ix_(free, free)], rhs[free])
    return out


@pytest.mark.parametrize("columns", [None, 1, 3, 9])
def test_solutions_are_exact_and_zero_where_held(search, columns):
    found = search.run()
    linearization = search.linearize(found)
    shape = (linearization.pattern.size,) if columns is None else (
        linearization.pattern.size, columns,
    )  # fmt: skip
    rhs = np.random.default_rng(0).standard_normal(shape)
    x = linearization.solve(rhs)
    assert np.all(x[linearization.fixed] == 0.0)
    expected = exact(linearization, rhs)
    np.testing.assert_allclose(x, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


def test_few_right_hand_sides_keep_newtons_factorisation(search):
    found = search.run()
    linearization = search.linearize(found)
    linearization.solve(np.ones(linearization.pattern.size))
    assert not linearization.exact
    linearization.solve(np.ones((linearization.pattern.size, 9)))
    assert linearization.exact


def test_right_hand_sides_are_left_alone(search):
    linearization = search.linearize(search.run())
    rhs = np.ones(linearization.pattern.size)
    linearization.solve(rhs)
    np.testing.assert_array_equal(rhs, 1.0)


def test_an_answer_that_needed_no_iteration_is_factored_anew(search):
    found = search.run()
    again = search.run(found.displacement)
    assert again.iterations == 0
    assert search.linearize(again).exact


def test_a_factorisation_too_old_to_refine_is_renewed(search):
    """Far from the answer refinement diverges; the exact tangent takes over."""
    found = search.run()
    linearization = search.linearize(found)
    old = linearization.values.copy()
    old[linearization.pattern.diagonal] *= 20.0
    linearization.lease.factor(old)
    rhs = np.random.default_rng(0).standard_normal(linearization.pattern.size)
    expected = exact(linearization, rhs)
    x = linearization.solve(rhs)
    assert linearization.exact
    np.testing.assert_allclose(x, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


def test_an_unstable_equilibrium_is_refused(search):
    found = search.run()
    good = search.linearize(found)
    bad = good.values.copy()
    bad[good.pattern.diagonal] -= 2.0 * np.abs(bad[good.pattern.diagonal]).max()
    unstable = Linearization(good.pattern, bad, good.lease, good.fixed)
    with pytest.raises(ConvergenceError, match=r"unstable.*lower the load"):
        unstable.solve(np.ones((good.pattern.size, 9)))

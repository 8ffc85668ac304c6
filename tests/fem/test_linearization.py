"""The tangent at an equilibrium: exact solutions, independent of the steps before."""

from dataclasses import replace

import numpy as np
import pytest

from tactorch.errors import ConvergenceError
from tactorch.fem import SoftBody, Supports, make_material


@pytest.fixture
def search(block, clamped):
    body = SoftBody(block, make_material("neo_hookean", 0.45))
    forces = body.pressure("z+", 0.1).numpy()
    return body.search(np.ones(block.n_tets), forces, Supports(fixed=clamped(block, "z-")))


def exact(linearization, rhs):
    """Solve with the dense free part of the tangent."""
    free = ~linearization.fixed
    pattern = linearization.assembly.discretisation.pattern
    dense = pattern.full(linearization.tangent).toarray()
    out = np.zeros_like(rhs)
    out[free] = np.linalg.solve(dense[np.ix_(free, free)], rhs[free])
    return out


@pytest.mark.parametrize("columns", [(), (1,), (3,), (9,)], ids=str)
def test_solutions_are_exact_and_zero_where_held(search, columns):
    linearization = search.linearize(search.run())
    rhs = np.random.default_rng(0).standard_normal((linearization.fixed.size, *columns))
    x = linearization.solve(rhs)
    assert np.all(x[linearization.fixed] == 0.0)
    expected = exact(linearization, rhs)
    np.testing.assert_allclose(x, expected, rtol=0, atol=1e-11 * np.abs(expected).max())


def test_values_are_those_of_the_equilibrium_not_of_the_step_before(search):
    found = search.run()
    values = search.linearize(found).tangent
    assembly, pattern = search.assembly, search.pattern
    response = assembly.respond(found.displacement)
    expected = pattern.apply_dirichlet(
        assembly.tangent(response, search.youngs), search.supports.fixed.ravel()
    )
    np.testing.assert_allclose(values, expected, rtol=0, atol=1e-14)


def test_one_factorisation_serves_all_solves(search, monkeypatch):
    linearization = search.linearize(search.run())
    factored = []
    factor = linearization.lease.factor
    monkeypatch.setattr(
        linearization.lease, "factor", lambda values: factored.append(1) or factor(values)
    )
    for _ in range(3):
        linearization.solve(np.ones(linearization.fixed.size))
    assert len(factored) == 1


def test_right_hand_sides_are_left_alone(search):
    linearization = search.linearize(search.run())
    rhs = np.ones(linearization.fixed.size)
    linearization.solve(rhs)
    np.testing.assert_array_equal(rhs, 1.0)


def test_an_answer_that_needed_no_iteration_has_a_tangent_too(search):
    found = search.run()
    again = search.run(found.displacement)
    assert again.iterations == 0
    rhs = np.ones(search.pattern.size)
    linearization = search.linearize(again)
    np.testing.assert_allclose(linearization.solve(rhs), exact(linearization, rhs), atol=1e-9)


def test_a_search_goes_on_after_its_solver_was_taken(search):
    """The linearisation factors with Newton's own solver; a later search must notice."""
    found = search.run()
    linearization = search.linearize(found)
    linearization.solve(np.ones(linearization.fixed.size))
    again = search.run()
    assert again.converged
    np.testing.assert_allclose(again.displacement, found.displacement, rtol=0, atol=1e-9)


def test_a_later_search_leaves_solutions_as_they_are(search):
    """A search factors with the solver that the linearisation shares; this one must notice."""
    linearization = search.linearize(search.run())
    rhs = np.random.default_rng(0).standard_normal(linearization.fixed.size)
    expected = linearization.solve(rhs)
    search.run()
    np.testing.assert_allclose(linearization.solve(rhs), expected, rtol=1e-12)


def test_an_unstable_equilibrium_is_refused(search):
    good = search.linearize(search.run())
    bad, diagonal = good.tangent.copy(), search.pattern.diagonal
    bad[diagonal] -= 2.0 * np.abs(bad[diagonal]).max()
    unstable = replace(good, tangent=bad)
    with pytest.raises(ConvergenceError, match=r"unstable.*lower the load"):
        unstable.solve(np.ones(good.fixed.size))


@pytest.mark.parametrize("solver", ["superlu", "torch_cg"])
def test_an_unstable_equilibrium_is_refused_by_every_kind_of_solver(block, clamped, solver):
    """The diagonal blocks stay positive definite, so that only solving finds the instability."""
    body = SoftBody(block, make_material("neo_hookean", 0.45), solver=solver)
    forces = body.pressure("z+", 0.1).numpy()
    search = body.search(np.ones(block.n_tets), forces, Supports(fixed=clamped(block, "z-")))
    good = search.linearize(search.run())
    free = np.flatnonzero(~good.fixed)
    eigenvalues, modes = np.linalg.eigh(search.pattern.full(good.tangent).toarray()[free][:, free])
    bad = good.tangent.copy()
    bad[search.pattern.diagonal[free]] -= 2.0 * eigenvalues[0]
    rhs = np.zeros(good.fixed.size)
    rhs[free] = modes[:, 0]
    with pytest.raises(ConvergenceError, match=r"unstable.*lower the load"):
        replace(good, tangent=bad).solve(rhs)

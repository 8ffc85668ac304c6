"""Conjugate gradients, preconditioned by the factorisation of a nearby matrix."""

import numpy as np
import pytest

from tactorch.linalg import analyse, available_solvers, conjugate_gradients

DIRECT = [name for name in available_solvers() if name in ("pardiso", "superlu")]


@pytest.fixture(params=DIRECT)
def solver(request, lattice):
    """A solver with the factorisation of the first lattice."""
    solver = analyse(lattice(0).pattern, request.param)
    solver.factor(lattice(0).values)
    return solver


def near(lattice, fraction):
    """Values between those of the first lattice and of another."""
    return (1.0 - fraction) * lattice(0).values + fraction * lattice(1).values


def solve(solver, values, rhs, rtol):
    return conjugate_gradients(
        lambda x: solver.pattern.product(values, x), solver.solve, rhs,
        rtol=rtol, max_iterations=10,
    )  # fmt: skip


@pytest.mark.parametrize("rtol", [1e-2, 1e-8])
def test_residual_is_below_the_tolerance(solver, lattice, rtol):
    values = near(lattice, 0.05)
    rhs = np.random.default_rng(0).standard_normal(solver.pattern.size)
    before = rhs.copy()
    x = solve(solver, values, rhs, rtol).solution
    residual = rhs - solver.pattern.full(values) @ x
    assert np.linalg.norm(residual) <= 1.001 * rtol * np.linalg.norm(rhs)
    np.testing.assert_array_equal(rhs, before)


def test_the_factored_matrix_itself_takes_one_iteration(solver, lattice):
    rhs = np.ones(solver.pattern.size)
    result = solve(solver, lattice(0).values, rhs, 1e-10)
    assert result.iterations == 1
    np.testing.assert_allclose(result.solution, solver.solve(rhs), rtol=1e-9)


def test_a_matrix_too_far_away_does_not_converge(solver, lattice):
    values = lattice(0).values.copy()
    values[solver.pattern.diagonal] *= np.logspace(0, 6, solver.pattern.size)
    rhs = np.random.default_rng(0).standard_normal(solver.pattern.size)
    assert not solve(solver, values, rhs, 1e-8).converged


def test_an_indefinite_matrix_is_noticed(solver, lattice):
    rhs = np.ones(solver.pattern.size)
    assert solve(solver, -lattice(0).values, rhs, 1e-8).negative_curvature

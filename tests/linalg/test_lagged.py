"""Solving with the factorisation of a nearby matrix."""

import numpy as np
import pytest

from tactorch.linalg import analyse, available, lagged_solve

DIRECT = [b for b in available() if b != "multigrid"]


@pytest.fixture(params=DIRECT)
def solver(request, lattice):
    """A solver that holds the factorisation of the first lattice."""
    solver = analyse(lattice(0).pattern, request.param)
    solver.factor(lattice(0).values)
    return solver


def near(lattice, share):
    """Values on the way from the first lattice to another."""
    return (1.0 - share) * lattice(0).values + share * lattice(1).values


@pytest.mark.parametrize("rtol", [1e-2, 1e-8])
def test_residual_is_as_small_as_asked(solver, lattice, rtol):
    values = near(lattice, 0.05)
    rhs = np.random.default_rng(0).standard_normal(solver.pattern.size)
    kept = rhs.copy()
    x = lagged_solve(solver.pattern, values, solver, rhs, rtol)
    residual = rhs - solver.pattern.full(values) @ x
    assert np.linalg.norm(residual) <= 1.001 * rtol * np.linalg.norm(rhs)
    np.testing.assert_array_equal(rhs, kept)


def test_its_own_matrix_takes_one_application(solver, lattice):
    applied = []

    class Counted:
        def solve(self, rhs):
            applied.append(1)
            return solver.solve(rhs)

    rhs = np.ones(solver.pattern.size)
    x = lagged_solve(solver.pattern, lattice(0).values, Counted(), rhs, 1e-10)
    assert len(applied) == 1
    np.testing.assert_allclose(x, solver.solve(rhs), rtol=1e-9)


def test_a_matrix_too_far_away_is_left_to_a_new_factorisation(solver, lattice):
    values = lattice(0).values.copy()
    values[solver.pattern.diagonal] *= np.logspace(0, 6, solver.pattern.size)
    rhs = np.random.default_rng(0).standard_normal(solver.pattern.size)
    assert lagged_solve(solver.pattern, values, solver, rhs, 1e-8) is None


def test_an_indefinite_matrix_is_noticed(solver, lattice):
    rhs = np.ones(solver.pattern.size)
    assert lagged_solve(solver.pattern, -lattice(0).values, solver, rhs, 1e-8) is None

"""Every backend times every operation."""

import threading

import numpy as np
import pytest

from tactorch.linalg import analyse, available_solvers, pardiso
from tactorch.linalg.solver import IndefiniteError

BACKENDS = available_solvers()


@pytest.fixture(params=BACKENDS)
def backend(request):
    return request.param


def test_solution_is_that_of_the_dense_matrix(backend, lattice):
    system = lattice(0)
    solver = analyse(system.pattern, backend)
    assert solver.factor(system.values)
    rhs = np.random.default_rng(1).standard_normal(system.pattern.size)
    expected = np.linalg.solve(system.dense, rhs)
    np.testing.assert_allclose(solver.solve(rhs), expected, rtol=0, atol=1e-11)


@pytest.mark.parametrize("order", ["C", "F"])
def test_many_right_hand_sides_are_solved_as_one_by_one(backend, order, lattice):
    system = lattice(0)
    solver = analyse(system.pattern, backend)
    solver.factor(system.values)
    rhs = np.asarray(
        np.random.default_rng(1).standard_normal((system.pattern.size, 5)), order=order
    )
    single = np.stack([solver.solve(np.ascontiguousarray(column)) for column in rhs.T], axis=1)
    np.testing.assert_allclose(solver.solve(rhs), single, rtol=0, atol=1e-13)


def test_right_hand_sides_are_left_alone(backend, lattice):
    system = lattice(0)
    solver = analyse(system.pattern, backend)
    solver.factor(system.values)
    rhs = np.ones(system.pattern.size)
    solver.solve(rhs)
    np.testing.assert_array_equal(rhs, 1.0)


def test_new_values_replace_the_old(backend, lattice):
    first, second = lattice(0), lattice(1)
    solver = analyse(first.pattern, backend)
    rhs = np.ones(first.pattern.size)
    for system in (first, second, first):
        assert solver.factor(system.values)
        expected = np.linalg.solve(system.dense, rhs)
        np.testing.assert_allclose(solver.solve(rhs), expected, rtol=0, atol=1e-11)


def test_the_callers_values_may_change_after_factoring(backend, lattice):
    system = lattice(0)
    solver = analyse(system.pattern, backend)
    values = system.values.copy()
    solver.factor(values)
    values[:] = np.nan
    rhs = np.ones(system.pattern.size)
    expected = np.linalg.solve(system.dense, rhs)
    np.testing.assert_allclose(solver.solve(rhs), expected, rtol=0, atol=1e-11)


@pytest.mark.parametrize("direct", [b for b in BACKENDS if b in ("pardiso", "superlu")])
def test_indefinite_matrices_are_reported_and_the_solver_lives_on(direct, lattice):
    system = lattice(0)
    solver = analyse(system.pattern, direct)
    shifted = system.values.copy()
    shifted[system.pattern.diagonal] -= 1.1 * np.linalg.eigvalsh(system.dense)[0]
    assert not solver.factor(shifted)
    assert solver.factor(system.values)
    rhs = np.ones(system.pattern.size)
    np.testing.assert_allclose(system.dense @ solver.solve(rhs), rhs, rtol=0, atol=1e-11)


@pytest.mark.parametrize("iterative", ["multigrid", "torch_cg"])
def test_iterative_solvers_report_indefinite_matrices_at_the_latest_when_solving(
    iterative, lattice
):
    system = lattice(0)
    solver = analyse(system.pattern, iterative)
    shifted = system.values.copy()
    shifted[system.pattern.diagonal] -= 1.1 * np.linalg.eigvalsh(system.dense)[0]
    lowest = np.linalg.eigh(system.dense)[1][:, 0]
    if solver.factor(shifted):
        with pytest.raises(IndefiniteError, match="positive definite"):
            solver.solve(lowest)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_values_that_are_not_finite_count_as_indefinite(backend, bad, lattice):
    system = lattice(0)
    solver = analyse(system.pattern, backend)
    values = system.values.copy()
    values[7] = bad
    assert not solver.factor(values)


def test_negative_diagonal_is_indefinite(backend, lattice):
    system = lattice(0)
    values = system.values.copy()
    values[system.pattern.diagonal[5]] *= -1.0
    assert not analyse(system.pattern, backend).factor(values)


def test_zero_right_hand_side_has_a_zero_solution(backend, lattice):
    system = lattice(0)
    solver = analyse(system.pattern, backend)
    solver.factor(system.values)
    np.testing.assert_array_equal(solver.solve(np.zeros(system.pattern.size)), 0.0)


def test_threads_side_by_side_agree_with_one_after_another(backend, lattice):
    systems = [lattice(seed) for seed in range(4)]
    rhs = np.random.default_rng(1).standard_normal((systems[0].pattern.size, 3))

    def work(i: int, out: dict[int, np.ndarray]) -> None:
        solver = analyse(systems[i].pattern, backend)
        for _ in range(5):
            assert solver.factor(systems[i].values)
            out[i] = solver.solve(rhs)

    alone: dict[int, np.ndarray] = {}
    for i in range(4):
        work(i, alone)
    together: dict[int, np.ndarray] = {}
    threads = [threading.Thread(target=work, args=(i, together)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(together) == [0, 1, 2, 3]
    for i in range(4):
        np.testing.assert_allclose(together[i], alone[i], rtol=0, atol=1e-13)


@pytest.mark.skipif("pardiso" not in BACKENDS, reason="pardiso is not installed")
def test_each_phase_of_pardiso_has_one_thread_whatever_that_of_the_caller_has(lattice, monkeypatch):
    """MKL fails where threads of one number analyse a matrix and of another one factor it."""
    threads, call = {}, pardiso._call

    def recorded(pt, iparm, phase, *arguments):
        threads[phase] = pardiso._library().MKL_Get_Max_Threads()
        return call(pt, iparm, phase, *arguments)

    monkeypatch.setattr(pardiso, "_call", recorded)
    system = lattice(0)
    previous = pardiso.set_local_threads(2)
    try:
        solver = analyse(system.pattern, "pardiso")
        solver.factor(system.values)
        solver.solve(np.ones(system.pattern.size))
        assert pardiso._library().MKL_Get_Max_Threads() == 2
    finally:
        pardiso.set_local_threads(previous)
    assert len(threads) == 3
    assert set(threads.values()) == {1}

import gc
import threading

import numpy as np
import pytest

from tactorch.linalg import SolverPool, SymmetricPattern, available_solvers
from tactorch.linalg.superlu import SuperLU


@pytest.fixture
def analyses(monkeypatch) -> list[SymmetricPattern]:
    """Patterns analysed so far."""
    patterns: list[SymmetricPattern] = []
    analyse = SuperLU.analyse

    def counted(self, pattern, coarse=None, single_precision=False):
        patterns.append(pattern)
        return analyse(self, pattern, coarse, single_precision)

    monkeypatch.setattr(SuperLU, "analyse", counted)
    return patterns


def test_a_collected_lease_gives_its_solver_back(lattice, analyses):
    solvers = SolverPool(lattice(0).pattern, "superlu")
    lease = solvers.lease()
    del lease
    gc.collect()
    again = solvers.lease()
    assert len(analyses) == 1
    other = solvers.lease()  # the first is on loan
    assert len(analyses) == 2
    del again, other


def test_a_closed_lease_gives_its_solver_back_once(lattice, analyses):
    solvers = SolverPool(lattice(0).pattern, "superlu")
    lease = solvers.lease()
    lease.close()
    lease.close()
    keep = [solvers.lease(), solvers.lease()]
    assert len(analyses) == 2  # not three, and the one solver is not lent twice
    assert len(keep) == 2


@pytest.mark.parametrize("backend", available_solvers())
def test_rough_solvers_are_lent_apart(backend, lattice):
    system = lattice(0)
    solvers = SolverPool(system.pattern, backend)
    single_precision, exact = solvers.lease(single_precision=True), solvers.lease()
    assert single_precision.single_precision == solvers.has_single_precision
    assert not exact.single_precision
    rhs = np.random.default_rng(0).standard_normal(system.pattern.size)
    for scale in (1.0, 1e-60):  # below the range of single precision
        expected = np.linalg.solve(system.dense, scale * rhs)
        for lease, error in ((single_precision, 1e-4), (exact, 1e-12)):
            assert lease.factor(system.values)
            np.testing.assert_allclose(
                lease.solve(scale * rhs), expected, rtol=0, atol=error * np.abs(expected).max()
            )
    heir = single_precision.transfer_factorization()
    assert (
        heir.single_precision
        == single_precision.transfer_factorization().single_precision
        == solvers.has_single_precision
    )
    heir.close()
    assert heir.transfer_factorization()._solver is not None


def test_a_closed_lease_lends_nothing_that_is_idle(lattice):
    solvers = SolverPool(lattice(0).pattern)
    closed = solvers.lease()
    closed.close()
    heir, other = closed.transfer_factorization(), solvers.lease()
    assert heir._solver is not other._solver
    with pytest.raises(RuntimeError, match="factor again"):
        closed.solve(np.ones(lattice(0).pattern.size))


def test_nothing_is_analysed_before_the_first_lease(lattice, analyses):
    SolverPool(lattice(0).pattern, "superlu")
    assert analyses == []


@pytest.mark.parametrize("backend", available_solvers())
def test_leases_hold_factorisations_of_their_own(backend, lattice):
    systems = [lattice(0), lattice(1)]
    solvers = SolverPool(systems[0].pattern, backend)
    leases = [solvers.lease() for _ in systems]
    for lease, system in zip(leases, systems, strict=True):
        assert lease.factor(system.values)
    rhs = np.ones(systems[0].pattern.size)
    for lease, system in zip(leases, systems, strict=True):
        expected = np.linalg.solve(system.dense, rhs)
        np.testing.assert_allclose(lease.solve(rhs), expected, rtol=0, atol=1e-11)


def test_threads_share_a_pool(lattice):
    systems = [lattice(seed) for seed in range(3)]
    solvers = SolverPool(systems[0].pattern)
    rhs = np.ones(systems[0].pattern.size)
    wrong: list[int] = []

    def work(i: int) -> None:
        for _ in range(20):
            lease = solvers.lease()
            lease.factor(systems[i].values)
            if not np.allclose(systems[i].dense @ lease.solve(rhs), rhs, atol=1e-11):
                wrong.append(i)
            lease.close()

    threads = [threading.Thread(target=work, args=(i,)) for i in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []

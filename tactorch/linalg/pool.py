"""Analysed solvers, reused between load cases."""

import threading
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial

import numpy as np
from jaxtyping import Float

from tactorch.linalg.conjugate_gradients import conjugate_gradients
from tactorch.linalg.pattern import SymmetricPattern
from tactorch.linalg.solver import SOLVERS, CoarseSpaces, Solver, SolverOptions


class Lease:
    """A solver on loan from a pool, returned when the lease is collected or closed."""

    def __init__(self, solver: Solver, pool: "SolverPool") -> None:
        self._pool = pool
        self.single_precision, self.direct = solver.single_precision, solver.direct
        self.about: object = None  # what the last factorisation is about, as given to `factor`
        self._take(solver)

    def _take(self, solver: Solver) -> None:
        self._solver: Solver | None = solver
        self._return = weakref.finalize(self, self._pool.give_back, solver)

    @property
    def factored(self) -> Float[np.ndarray, " nnz"] | None:
        """Values of the factored matrix; None without a factorisation."""
        return None if self._solver is None else self._solver.factored

    def close(self) -> None:
        """Return the solver; the next `factor` takes another one from the pool."""
        self._return()
        self._solver = None

    @contextmanager
    def hold(self) -> Iterator["Lease"]:
        """Give the lease to the calling thread, as `SharedLease.hold` does."""
        yield self

    def transfer_factorization(self) -> "Lease":
        """Return a lease of the same solver and factorisation; this one is left without.

        The next `factor` of this lease takes another solver from the pool.
        """
        solver, self._solver = self._solver, None
        if solver is None:
            return self._pool.lease(self.single_precision)
        self._return.detach()
        return Lease(solver, self._pool)

    def factor(self, values: Float[np.ndarray, " nnz"], about: object = None) -> bool:
        """See `Solver.factor`; `about` is kept as an attribute."""
        self.about = about
        if self._solver is None:
            self._take(self._pool.take(self.single_precision))
        assert self._solver is not None
        return self._solver.factor(values)

    def solve(
        self, rhs: Float[np.ndarray, "size *k"], rtol: float = 0.0
    ) -> Float[np.ndarray, "size *k"]:
        """See `Solver.solve`."""
        if self._solver is None:
            raise RuntimeError("the factorisation was transferred; factor again before solving")
        return self._solver.solve(rhs, rtol)

    def solve_similar(
        self,
        values: Float[np.ndarray, " nnz"],
        rhs: Float[np.ndarray, "size *k"],
        rtol: float,
        max_iterations: int,
    ) -> Float[np.ndarray, "size *k"] | None:
        """Solve with another matrix by conjugate gradients, which the factorisation preconditions.

        None without a factorisation that is cheap to solve with, and without convergence.
        """
        if self.factored is None or not self.direct:
            return None
        result = conjugate_gradients(
            partial(self._pool.pattern.product, values), self.solve, rhs,
            rtol=rtol, max_iterations=max_iterations,
        )  # fmt: skip
        return result.solution if result.converged else None


class SharedLease:
    """Factorisations that load cases of similar tangents share, as preconditioners.

    Each thread that needs one at the same time has another one, so that there are no more than
    threads, however many load cases there are.
    """

    def __init__(self, pool: "SolverPool", single_precision: bool = False) -> None:
        self._pool = pool
        self.single_precision = single_precision and pool.has_single_precision
        self._idle: list[Lease] = []

    @contextmanager
    def hold(self) -> Iterator[Lease]:
        """Lend a factorisation to the calling thread, which may replace it."""
        try:
            lease = self._idle.pop()  # the last one used: its factorisation is the most similar
        except IndexError:
            lease = self._pool.lease(self.single_precision)
        try:
            yield lease
        finally:
            self._idle.append(lease)

    def close(self) -> None:
        """Do nothing: other load cases use the factorisations."""

    def transfer_factorization(self) -> "SharedLease":
        """Return self."""
        return self


class SolverPool:
    """Lends solvers for one pattern; analyses another only when all are on loan.

    Args:
        pattern: Sparsity of the matrices.
        solver: Name or settings of the solver.
        coarse: Fields for multigrid.
    """

    def __init__(
        self,
        pattern: SymmetricPattern,
        solver: str | SolverOptions = "auto",
        coarse: CoarseSpaces | None = None,
    ) -> None:
        self.pattern = pattern
        options: SolverOptions = SOLVERS.build(solver)
        self.options = options.resolve(pattern.size)
        #: Whether there are solvers that factor faster, to about four digits.
        self.has_single_precision = self.options.has_single_precision
        self._coarse = coarse
        self._idle: dict[bool, list[Solver]] = {False: [], True: []}
        self._lock = threading.RLock()  # a finalizer may run in the thread that has the lock

    def lease(self, single_precision: bool = False) -> Lease:
        """Lend a solver, in single precision if wanted and supported."""
        return Lease(self.take(single_precision), self)

    def take(self, single_precision: bool = False) -> Solver:
        """Take out an idle solver, or a newly analysed one; used by leases."""
        single_precision = single_precision and self.has_single_precision
        with self._lock:
            idle = self._idle[single_precision]
            solver = idle.pop() if idle else None
        return solver or self.options.analyse(self.pattern, self._coarse, single_precision)

    def give_back(self, solver: Solver) -> None:
        """Return a solver; used by leases."""
        solver.factored = None
        with self._lock:
            self._idle[solver.single_precision].append(solver)

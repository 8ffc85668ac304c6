"""Analysed solvers, kept for reuse, one factorisation each."""

import threading
import weakref

import numpy as np
from jaxtyping import Float

from tactorch.linalg.choose import analyse, resolve
from tactorch.linalg.pattern import SymmetricPattern
from tactorch.linalg.protocol import Solver, Status


class Lease:
    """A solver on loan from a pool; it goes back when the lease is collected or `close`d."""

    def __init__(self, solver: Solver, pool: "SolverPool") -> None:
        """Take over `solver`; used by `SolverPool.lease`."""
        self._pool = pool
        self._take(solver)

    def _take(self, solver: Solver) -> None:
        self.factored = False
        self._solver: Solver | None = solver
        self.direct = solver.direct
        self.single_precision = solver.single_precision
        self._return = weakref.finalize(self, self._pool._take_back, solver)

    def close(self) -> None:
        """Give the solver back; the next `factor` takes another."""
        self._return()
        self._solver, self.factored = None, False

    @property
    def handed_over(self) -> bool:
        """Whether the solver is another lease's now, or the pool's."""
        return self._solver is None

    def transfer_factorization(self) -> "Lease":
        """Return a lease of the same solver, its factorisation included; this one loses both.

        The next `factor` takes another solver from the pool.
        """
        solver, self._solver = self._solver, None
        if solver is None:
            return self._pool.lease(self.single_precision)
        self._return.detach()
        heir = Lease(solver, self._pool)
        heir.factored = self.factored
        return heir

    def factor(self, values: Float[np.ndarray, " nnz"]) -> Status:
        """See `Solver.factor`."""
        if self._solver is None:
            self._take(self._pool.idle(self.single_precision))
        assert self._solver is not None
        status = self._solver.factor(values)
        self.factored = status is Status.OK
        return status

    def solve(self, rhs: Float[np.ndarray, "size *k"]) -> Float[np.ndarray, "size *k"]:
        """See `Solver.solve`.

        Raises:
            RuntimeError: the factorisation was handed over.
        """
        if self._solver is None:
            raise RuntimeError("the factorisation was handed over; factor anew before solving")
        return self._solver.solve(rhs)


class SolverPool:
    """Hands out solvers for one pattern, analysing anew only when all are on loan."""

    def __init__(
        self,
        pattern: SymmetricPattern,
        backend: str = "auto",
        near_nullspace: Float[np.ndarray, "size modes"] | None = None,
    ) -> None:
        """Nothing is analysed before the first `lease`."""
        self.pattern = pattern
        self.backend = resolve(backend, pattern.size)
        self._modes = near_nullspace
        self._idle: dict[bool, list[Solver]] = {False: [], True: []}
        self._lock = threading.RLock()  # a finalizer may run inside the lock's own thread

    @property
    def has_single_precision(self) -> bool:
        """Whether this backend has solvers that factor faster and solve less exactly."""
        return self.backend == "pardiso"

    def lease(self, single_precision: bool = False) -> Lease:
        """Lend an idle solver, or a newly analysed one; a rough one if the backend has it."""
        return Lease(self.idle(single_precision), self)

    def idle(self, single_precision: bool = False) -> Solver:
        """Take out an idle solver, or a newly analysed one; for leases."""
        single_precision = single_precision and self.has_single_precision
        with self._lock:
            idle = self._idle[single_precision]
            solver = idle.pop() if idle else None
        return solver or analyse(self.pattern, self.backend, self._modes, single_precision)

    def _take_back(self, solver: Solver) -> None:
        with self._lock:
            self._idle[solver.single_precision].append(solver)

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
        self._solver = solver
        self.direct = solver.direct
        self.close = weakref.finalize(self, pool._take_back, solver)

    def factor(self, values: Float[np.ndarray, " nnz"]) -> Status:
        """See `Solver.factor`."""
        return self._solver.factor(values)

    def solve(self, rhs: Float[np.ndarray, "size *k"]) -> Float[np.ndarray, "size *k"]:
        """See `Solver.solve`."""
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
        self._idle: list[Solver] = []
        self._lock = threading.RLock()  # a finalizer may run inside the lock's own thread

    def lease(self) -> Lease:
        """Lend an idle solver, or a newly analysed one."""
        with self._lock:
            solver = self._idle.pop() if self._idle else None
        return Lease(solver or analyse(self.pattern, self.backend, self._modes), self)

    def _take_back(self, solver: Solver) -> None:
        with self._lock:
            self._idle.append(solver)

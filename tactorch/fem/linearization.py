"""The tangent at an equilibrium, factored once and used by everyone."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float

from tactorch.errors import ConvergenceError
from tactorch.linalg import Status, SymmetricPattern
from tactorch.linalg.pool import Lease

_REFINED = 1e-13
_SWEEPS = 4
_MANY = 4


@dataclass(eq=False)
class Linearization:
    """K at an equilibrium, with a factorisation at hand.

    Newton's last factorisation belongs to the iterate before the last. For few right-hand sides
    it serves through iterative refinement with the exact K; for many it is renewed once.

    Attributes:
        values: Stored entries of K with the fixed unknowns held.
        lease: Factorised solver.
        fixed: Fixed unknowns, flat.
        exact: Whether the factorisation belongs to `values`.
    """

    pattern: SymmetricPattern
    values: Float[np.ndarray, " nnz"]
    lease: Lease
    fixed: Bool[np.ndarray, " size"]
    exact: bool = field(default=False)

    def solve(self, rhs: Float[np.ndarray, "size *k"]) -> Float[np.ndarray, "size *k"]:
        """Solve K x = rhs with x zero at fixed unknowns.

        Raises:
            ConvergenceError: K is not positive definite: the equilibrium is unstable.
        """
        if self.fixed.any():
            rhs = rhs.copy(order="K")
            rhs[self.fixed] = 0.0
        if self.exact or (rhs.ndim == 2 and rhs.shape[1] > _MANY):
            return self._exact(rhs)
        return self._refined(rhs)

    def _exact(self, rhs: np.ndarray) -> np.ndarray:
        if not self.exact:
            if self.lease.factor(self.values) is Status.INDEFINITE:
                raise ConvergenceError(
                    "The equilibrium is unstable (its tangent is not positive definite), so no "
                    "derivative exists there; lower the load."
                )
            self.exact = True
        return self.lease.solve(rhs)

    def _refined(self, rhs: np.ndarray) -> np.ndarray:
        x = self.lease.solve(rhs)
        goal = _REFINED * np.abs(rhs).max(initial=0.0)
        previous = np.inf
        for _ in range(_SWEEPS):
            residual = rhs - self.pattern.product(self.values, x)
            error = np.abs(residual).max(initial=0.0)
            if error <= goal or error > 0.3 * previous:
                break
            x = x + self.lease.solve(residual)
            previous = error
        # Round-off stalls refinement near the goal; a poor factorisation stalls it far away.
        return x if error <= 1e3 * goal else self._exact(rhs)

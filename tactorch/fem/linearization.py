"""The tangent at an equilibrium, factored once and used by everyone."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float

from tactorch.errors import ConvergenceError
from tactorch.linalg import Status, SymmetricPattern
from tactorch.linalg.pool import Lease


@dataclass(eq=False)
class Linearization:
    """K at an equilibrium; factored at the first solve, or before.

    Attributes:
        pattern: Sparsity of K.
        values: Stored entries of K with the fixed unknowns held.
        lease: Solver to factor with.
        fixed: Fixed unknowns, flat.
    """

    pattern: SymmetricPattern
    values: Float[np.ndarray, " nnz"]
    lease: Lease
    fixed: Bool[np.ndarray, " size"]
    _factored: bool = field(default=False)

    def factor(self) -> None:
        """Factor K, unless it is.

        Raises:
            ConvergenceError: K is not positive definite: the equilibrium is unstable.
        """
        if self._factored and not self.lease.handed_over:
            return
        if self.lease.factor(self.values) is Status.INDEFINITE:
            raise ConvergenceError(
                "The equilibrium is unstable (its tangent is not positive definite), so no "
                "derivative exists there; lower the load."
            )
        self._factored = True

    def solve(self, rhs: Float[np.ndarray, "size *k"]) -> Float[np.ndarray, "size *k"]:
        """Solve K x = rhs with x zero at fixed unknowns.

        Raises:
            ConvergenceError: K is not positive definite: the equilibrium is unstable.
        """
        self.factor()
        if self.fixed.any():
            rhs = rhs.copy(order="K")
            rhs[self.fixed] = 0.0
        return self.lease.solve(rhs)

"""The prior as a preconditioner: what it rules over, conjugate gradients need not learn."""

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float

from tactorch.linalg import Solver, Status, SymmetricPattern, analyse


class PriorSolver:
    """Solves with the prior's curvature plus a diagonal; its pattern is analysed once."""

    def __init__(self) -> None:
        """Nothing is analysed before the first `factor`."""
        self._of: tuple[np.ndarray, np.ndarray] | None = None
        self._fixed = np.zeros(0, dtype=bool)

    def factor(
        self,
        prior: sp.csr_matrix,
        shift: Float[np.ndarray, " size"],
        fixed: Bool[np.ndarray, " size"],
    ) -> bool:
        """Factor prior + diagonal with fixed unknowns held; tell whether it is definite."""
        prior = prior.tocsr()
        if self._of is None or not _same(self._of, prior):
            self._analyse(prior)
        values = np.zeros(self._pattern.nnz)
        np.add.at(values, self._slots, prior.data[self._upper])
        values[self._pattern.diagonal] += shift
        self._fixed = fixed
        return self._solver.factor(self._pattern.apply_dirichlet(values, fixed)) is Status.OK

    def _analyse(self, prior: sp.csr_matrix) -> None:
        self._of = prior.indptr.copy(), prior.indices.copy()
        coo = prior.tocoo()
        rows, cols = coo.row.astype(np.int64), coo.col.astype(np.int64)
        self._upper = rows <= cols
        self._pattern = SymmetricPattern.from_pairs(prior.shape[0], rows, cols)
        self._slots = self._pattern.slots(rows[self._upper], cols[self._upper])
        self._solver: Solver = analyse(self._pattern, "auto")

    def solve(self, rhs: Float[np.ndarray, " size"]) -> Float[np.ndarray, " size"]:
        """Solve; fixed unknowns stay zero."""
        out = self._solver.solve(np.where(self._fixed, 0.0, rhs))
        return np.where(self._fixed, 0.0, out)


def _same(pattern: tuple[np.ndarray, np.ndarray], matrix: sp.csr_matrix) -> bool:
    return np.array_equal(pattern[0], matrix.indptr) and np.array_equal(pattern[1], matrix.indices)

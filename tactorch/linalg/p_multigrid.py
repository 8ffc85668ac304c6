"""Multigrid in the degree of the elements: quadratic ones, with linear ones as the coarse grid.

A Chebyshev polynomial of the diagonal blocks smooths errors that linear elements cannot represent,
and a direct solver removes the others. References: E. M. Ronquist and A. T. Patera, "Spectral
element multigrid. I", J. Sci. Comput. 2 (1987), 389-406; M. Adams, M. Brezina, J. Hu and R.
Tuminaro, "Parallel multigrid smoothing: polynomial versus Gauss-Seidel", J. Comput. Phys. 188
(2003), 593-610.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from tactorch.config import option
from tactorch.linalg.blocks import SIZE, BlockMatrix, Real, upper_blocks
from tactorch.linalg.conjugate_gradients import conjugate_gradients
from tactorch.linalg.iterative import IterativeSolver, by_columns, fixed_unknowns
from tactorch.linalg.pattern import SymmetricPattern
from tactorch.linalg.solver import IndefiniteError, Solver, SolverOptions, analyse

_DEGREE = 3  # of the polynomial
_RANGE = 30.0  # of the eigenvalues that the polynomial reduces
_POWER_STEPS = 30  # for the largest eigenvalue
_MARGIN = 1.15  # of the largest eigenvalue, which these steps underestimate
_SINGLE_RTOL = 1e-2  # of solutions for which a matrix in single precision suffices
_STALE_ITERATIONS = 4.0  # with the cycle of another matrix, for each digit and two more


@dataclass(frozen=True, eq=False)
class _Smoother:
    """Chebyshev polynomial of a matrix with the inverse of its diagonal blocks."""

    matrix: BlockMatrix | sp.bsr_matrix
    inverse: BlockMatrix | sp.bsr_matrix  # of the diagonal blocks
    largest: float

    @staticmethod
    def of(upper: sp.bsr_matrix) -> "_Smoother | None":
        """Return the smoother; None if a diagonal block is not positive definite."""
        diagonal = upper.data[upper.indptr[:-1]]
        if not np.linalg.eigvalsh(diagonal).min() > 0.0:
            return None
        places = np.arange(len(diagonal) + 1)
        inverses = sp.bsr_matrix((np.linalg.inv(diagonal), places[:-1], places))
        if upper.blocksize[0] == SIZE:
            single, inverse = BlockMatrix.of(upper), BlockMatrix.of(inverses)
        else:
            both = upper + sp.triu(upper, 1).T
            single, inverse = both.astype(Real), inverses.astype(Real)
        vector = np.random.default_rng(0).standard_normal(upper.shape[0]).astype(Real)
        for _ in range(_POWER_STEPS):
            vector = inverse @ (single @ vector)
            largest = float(np.sqrt(np.square(vector).sum()))
            vector /= largest
        return _Smoother(single, inverse, _MARGIN * largest)

    def __call__(self, residual: np.ndarray) -> np.ndarray:
        """Return the approximate solution for a right-hand side.

        Y. Saad, "Iterative methods for sparse linear systems", 2nd ed. (2003), algorithm 12.1.
        """
        smallest = self.largest / _RANGE
        center, half = 0.5 * (self.largest + smallest), 0.5 * (self.largest - smallest)
        ratio = center / half
        rho = 1.0 / ratio
        change = self.inverse @ residual / center
        solution = change.copy()
        for _ in range(_DEGREE - 1):
            residual = residual - self.matrix @ change
            rho, before = 1.0 / (2.0 * ratio - rho), rho
            change = rho * before * change + (2.0 * rho / half) * (self.inverse @ residual)
            solution += change
        return solution


@dataclass(frozen=True, eq=False)
class _Cycle:
    """A V-cycle: smoothing, the solution of the coarse problem, smoothing."""

    smoother: _Smoother
    interpolation: sp.csr_matrix
    coarse: Solver

    def __call__(self, residual: np.ndarray) -> np.ndarray:
        unit = float(np.abs(residual).max()) or 1.0
        b = (residual / unit).astype(Real)
        solution = self.smoother(b)
        matrix, interpolation = self.smoother.matrix, self.interpolation
        coarse = interpolation.T @ (b - matrix @ solution)
        solution += (interpolation @ self.coarse.solve(coarse)).astype(Real)
        solution += self.smoother(b - matrix @ solution)
        return unit * solution.astype(np.float64)


class PMultigridSolver(IterativeSolver):
    """Conjugate gradients with a V-cycle, which serves while the matrix changes little."""

    _cycle: Any = None
    _current = False  # whether the cycle is that of the present matrix

    def _factor(self, values: np.ndarray) -> bool:
        if np.any(values[self.pattern.diagonal] <= 0.0):
            return False
        self._values, self._current = values.copy(), False
        return self._cycle is not None or self._renew()

    def _renew(self) -> bool:
        """Set up the cycle of the present matrix; False if it is found not positive definite."""
        self._cycle, self._current = self._new_cycle(), True
        return self._cycle is not None

    def _new_cycle(self) -> _Cycle | None:
        blocks, interpolation = upper_blocks(self.pattern, self._values), self.linear
        if (smoother := _Smoother.of(blocks)) is None:
            return None
        if interpolation is None:
            interpolation = sp.identity(self.pattern.size)
        free = ~fixed_unknowns(self.pattern, self._values)
        interpolation = sp.csr_matrix(sp.diags(free.astype(np.float64)) @ interpolation)
        by_blocks = interpolation.tobsr(blocks.blocksize)
        blocks.data[blocks.indptr[:-1]] *= 0.5
        half = by_blocks.T @ (blocks @ by_blocks)  # the coarse matrix is this and its transpose
        coarse = sp.csr_matrix(half + half.T)
        # Columns of fixed unknowns only are zero.
        coarse = coarse + sp.diags(np.where(coarse.diagonal() > 0.0, 0.0, 1.0))
        upper = sp.csr_matrix(sp.triu(coarse))
        upper.sort_indices()
        pattern = SymmetricPattern(upper.indptr, upper.indices)
        solver = analyse(pattern, single_precision=True)
        return _Cycle(smoother, interpolation, solver) if solver.factor(upper.data) else None

    def _solve(self, rhs: np.ndarray, rtol: float) -> np.ndarray:
        return by_columns(lambda b: self._solve_column(b, rtol), rhs)

    def _solve_column(self, rhs: np.ndarray, rtol: float) -> np.ndarray:
        if not self._current:
            tolerance = max(rtol, self.options.rtol)
            limit = int(_STALE_ITERATIONS * (2.0 - np.log10(tolerance)))
            stale = conjugate_gradients(
                self._product, self._cycle, rhs, rtol=tolerance, max_iterations=limit
            )
            if stale.converged:
                return np.asarray(stale.solution)
            if not self._renew():
                raise IndefiniteError("the matrix is not positive definite")
        single = rtol >= _SINGLE_RTOL
        product = self._cycle.smoother.matrix.__matmul__ if single else self._product
        return np.asarray(self._iterate(product, self._cycle, rhs, rtol))

    def _product(self, x: Any) -> Any:
        return self.pattern.product(self._values, x)


@dataclass(frozen=True)
class PMultigrid(SolverOptions):
    """Conjugate gradients with linear elements as the coarse grid of quadratic ones."""

    solver = PMultigridSolver

    rtol: float = option(1e-12, "Relative residual at which a solve ends", gt=0, lt=1)
    max_iterations: int = option(200, "Limit of iterations in one solve", ge=1)

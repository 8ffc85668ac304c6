"""Iterative solvers: preconditioned conjugate gradients, for the largest meshes.

Multigrid by smoothed aggregation takes the near-nullspace (the six rigid-body modes in elasticity),
which makes its convergence independent of the mesh size (Vanek, Mandel and Brezina, 1996). The
solver in PyTorch solves all right-hand sides at once, on a GPU where there is one.
"""

import logging
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from tactorch.config import option
from tactorch.errors import ConfigError, ConvergenceError
from tactorch.linalg.blocks import upper_blocks
from tactorch.linalg.conjugate_gradients import conjugate_gradients
from tactorch.linalg.pattern import SymmetricPattern
from tactorch.linalg.solver import (
    SOLVERS,
    IndefiniteError,
    Solver,
    SolverOptions,
    direct_solver,
)

_log = logging.getLogger("tactorch")


class IterativeSolver(Solver):
    """Conjugate gradients within the limits `options.rtol` and `options.max_iterations`."""

    direct = False
    _substitute: Solver | None = None  # a direct solver

    def factor(self, values: Float[np.ndarray, " nnz"]) -> bool:
        """See `Solver.factor`."""
        if self._substitute is None:
            return super().factor(values)
        definite = self._substitute.factor(values)
        self.factored = values if definite else None
        return definite

    def solve(
        self, rhs: Float[np.ndarray, "size *k"], rtol: float = 0.0
    ) -> Float[np.ndarray, "size *k"]:
        """See `Solver.solve`; from a failure to converge on, a direct solver takes over."""
        if self._substitute is None:
            try:
                return super().solve(rhs, rtol)
            except ConvergenceError as error:
                _log.warning("%s; a direct solver continues.", error)
            assert self.factored is not None
            self._substitute = direct_solver().analyse(self.pattern)
            if not self.factor(self.factored):
                raise IndefiniteError("the matrix is not positive definite")
        return self._substitute.solve(rhs)

    def _iterate(
        self,
        product: Callable[[Any], Any],
        precondition: Callable[[Any], Any],
        rhs: Any,
        rtol: float,
    ) -> Any:
        rtol, limit = max(rtol, self.options.rtol), self.options.max_iterations
        result = conjugate_gradients(product, precondition, rhs, rtol=rtol, max_iterations=limit)
        if result.negative_curvature:
            raise IndefiniteError("negative curvature: the matrix is not positive definite")
        if not result.converged:
            residual = float(abs(rhs - result.image).max() / abs(rhs).max())
            name = SOLVERS.name_of(type(self.options))
            raise ConvergenceError(
                f"solver={name} did not converge: a relative residual of {residual:.1e}, not "
                f"{rtol:.0e}, in {limit} iterations"
            )
        return result.solution


def by_columns(solve: Callable[[np.ndarray], np.ndarray], rhs: np.ndarray) -> np.ndarray:
    """Return the solutions for one or many right-hand sides, one after the other."""
    columns = np.array(rhs.reshape(len(rhs), -1).T, dtype=np.float64, order="C")
    return np.stack([solve(column) for column in columns], axis=1).reshape(rhs.shape)


def fixed_unknowns(
    pattern: SymmetricPattern, values: Float[np.ndarray, " nnz"]
) -> Bool[np.ndarray, " size"]:
    """Return the unknowns whose rows have a diagonal entry only."""
    counts = pattern.product((values != 0.0).astype(np.float32), np.ones(pattern.size))
    return np.asarray(counts == 1.0)


class MultigridSolver(IterativeSolver):
    """Conjugate gradients with multigrid; the aggregates of the first matrix are reused."""

    _aggregates: list[sp.csr_matrix] | None = None

    def _factor(self, values: np.ndarray) -> bool:
        import pyamg

        self._matrix = full = self.pattern.full(values)
        if np.any(full.diagonal() <= 0):
            return False
        block = full.tobsr((3, 3)) if self.pattern.size % 3 == 0 else full
        options: dict[str, Any] = {}
        if self.near_nullspace is not None:
            fixed = fixed_unknowns(self.pattern, values)
            options["B"] = np.where(fixed[:, None], 0.0, self.near_nullspace)
        if self._aggregates:
            options["aggregate"] = [("predefined", {"AggOp": a}) for a in self._aggregates]
            options["max_levels"] = len(self._aggregates) + 1
        hierarchy = pyamg.smoothed_aggregation_solver(
            block, keep=True, max_coarse=300, coarse_solver="splu", symmetry="symmetric", **options
        )
        if self._aggregates is None:
            self._aggregates = [level.AggOp for level in hierarchy.levels[:-1]]
        self._preconditioner = hierarchy.aspreconditioner(cycle="V")
        return True

    def _solve(self, rhs: np.ndarray, rtol: float) -> np.ndarray:
        product, precondition = self._matrix.__matmul__, self._preconditioner.__matmul__
        return by_columns(lambda b: self._iterate(product, precondition, b, rtol), rhs)


@dataclass(frozen=True)
class Multigrid(SolverOptions):
    """Conjugate gradients with algebraic multigrid, for the largest meshes."""

    solver = MultigridSolver
    requires: ClassVar[str] = "pyamg"

    rtol: float = option(1e-12, "Relative residual at which a solve ends", gt=0, lt=1)
    max_iterations: int = option(500, "Limit of iterations in one solve", ge=1)

    @staticmethod
    def available() -> bool:
        return find_spec("pyamg") is not None


class TorchCGSolver(IterativeSolver):
    """Conjugate gradients, preconditioned by the inverse diagonal blocks of the nodes."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        device = self.options.device or ("cuda" if torch.cuda.is_available() else "cpu")
        if device.startswith("cuda"):
            count = torch.cuda.device_count() if torch.cuda.is_available() else 0
            if (torch.device(device).index or 0) >= count:
                raise ConfigError(
                    f"solver.device={device}: there are {count} CUDA devices; give one of these,"
                    " cpu or null."
                )
        self._device = torch.device(device)

    def _factor(self, values: np.ndarray) -> bool:
        full = self.pattern.full(values)
        upper = upper_blocks(self.pattern, values)
        diagonal = torch.from_numpy(upper.data[upper.indptr[:-1]])
        factors, info = torch.linalg.cholesky_ex(diagonal.to(self._device))
        if bool(info.any()):  # a diagonal block is indefinite
            return False
        self._inverse_blocks = torch.cholesky_inverse(factors)
        rows, cols = (torch.from_numpy(x.astype(np.int64)) for x in (full.indptr, full.indices))
        data = torch.from_numpy(full.data)
        with warnings.catch_warnings():  # sparse tensors are declared a beta feature
            warnings.simplefilter("ignore", UserWarning)
            matrix = torch.sparse_csr_tensor(rows, cols, data, size=full.shape)
            self._matrix = matrix.to(self._device)
        return True

    def _solve(self, rhs: np.ndarray, rtol: float) -> np.ndarray:
        columns = torch.tensor(rhs, device=self._device).reshape(len(rhs), -1)
        with torch.no_grad():
            solution = self._iterate(self._matrix.matmul, self._precondition, columns, rtol)
        return solution.reshape(rhs.shape).cpu().numpy()

    def _precondition(self, residual: Tensor) -> Tensor:
        blocks = residual.reshape(*self._inverse_blocks.shape[:2], -1)
        return (self._inverse_blocks @ blocks).reshape(residual.shape)


@dataclass(frozen=True)
class TorchCG(SolverOptions):
    """Conjugate gradients in PyTorch, for GPUs; on the CPU direct solvers are faster."""

    solver = TorchCGSolver

    device: str | None = option(None, "Torch device, such as cuda; null: a GPU if there is one")
    rtol: float = option(1e-12, "Relative residual at which a solve ends", gt=0, lt=1)
    max_iterations: int = option(20_000, "Limit of iterations in one solve", ge=1)

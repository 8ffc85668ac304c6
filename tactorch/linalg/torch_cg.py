"""Conjugate gradients in PyTorch, for all right-hand sides at once, on a GPU where there is one."""

import warnings
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from tactorch.config import option
from tactorch.errors import ConfigError
from tactorch.linalg.pattern import SymmetricPattern
from tactorch.linalg.solver import IterativeSolver, SolverOptions, Status

_BLOCK = 3  # unknowns of a node


@dataclass(frozen=True)
class TorchCG(SolverOptions):
    """Conjugate gradients in PyTorch, for GPUs."""

    device: str | None = option(None, "Torch device, such as cuda; null: a GPU if there is one")
    rtol: float = option(1e-12, "Relative residual at which a solve ends", gt=0, lt=1)
    max_iterations: int = option(20_000, "Limit of iterations in one solve", ge=1)

    def analyse(
        self,
        pattern: SymmetricPattern,
        near_nullspace: Float[np.ndarray, "size modes"] | None = None,
        single_precision: bool = False,
    ) -> "TorchCGSolver":
        """See `SolverOptions.analyse`.

        Raises:
            ConfigError: There is no such device.
        """
        device = self.device or ("cuda" if torch.cuda.is_available() else "cpu")
        if device.startswith("cuda") and not torch.cuda.is_available():
            raise ConfigError(f"solver.device={device}: there is no CUDA device; give cpu or null.")
        return TorchCGSolver(self, pattern, torch.device(device))


class TorchCGSolver(IterativeSolver):
    """Solves for all right-hand sides at once; see `tactorch.linalg.Solver`.

    The inverse diagonal blocks of the nodes precondition the iteration. On the CPU direct solvers
    are faster.

    Args:
        options: Settings.
        pattern: The matrix pattern.
        device: Device that the matrix is kept on.
    """

    def __init__(self, options: TorchCG, pattern: SymmetricPattern, device: torch.device) -> None:
        self.options = options
        self.pattern = pattern
        self.device = device
        self._matrix: Tensor | None = None
        self._inverse_blocks = torch.empty(0)

    def factor(self, values: Float[np.ndarray, " nnz"]) -> Status:
        """Invert the diagonal blocks; the matrix is indefinite if one of them is."""
        if not np.all(np.isfinite(values)):
            return Status.INDEFINITE
        full = self.pattern.full(values)
        block = _BLOCK if self.pattern.size % _BLOCK == 0 else 1
        nodes = np.arange(0, self.pattern.size, block)[:, None, None] + 0 * np.eye(block, dtype=int)
        rows, cols = nodes + np.arange(block)[:, None], nodes + np.arange(block)
        blocks = np.asarray(full[rows.ravel(), cols.ravel()]).reshape(rows.shape)
        factors, info = torch.linalg.cholesky_ex(torch.from_numpy(blocks).to(self.device))
        if bool(info.any()):
            return Status.INDEFINITE
        self._inverse_blocks = torch.cholesky_inverse(factors)
        with warnings.catch_warnings():  # sparse tensors are declared a beta feature
            warnings.simplefilter("ignore", UserWarning)
            self._matrix = torch.sparse_csr_tensor(
                torch.from_numpy(full.indptr.astype(np.int64)),
                torch.from_numpy(full.indices.astype(np.int64)),
                torch.from_numpy(full.data),
                size=full.shape,
            ).to(self.device)
        return Status.OK

    def solve(self, rhs: Float[np.ndarray, "size *k"]) -> Float[np.ndarray, "size *k"]:
        """Return the solution for one or many right-hand sides.

        Raises:
            ConvergenceError: The residual is not reached within the limit of iterations.
            IndefiniteError: Negative curvature is met.
        """
        matrix = self._matrix
        if matrix is None:
            raise RuntimeError("factor the matrix before solving")
        columns = torch.tensor(rhs, device=self.device).reshape(len(rhs), -1)
        with torch.no_grad():
            solution = self._iterate(lambda x: matrix @ x, self._precondition, columns)
        return solution.reshape(rhs.shape).cpu().numpy()

    def _precondition(self, residual: Tensor) -> Tensor:
        blocks = residual.reshape(*self._inverse_blocks.shape[:2], -1)
        return (self._inverse_blocks @ blocks).reshape(residual.shape)

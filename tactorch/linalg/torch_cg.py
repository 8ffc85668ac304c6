"""Conjugate gradients in PyTorch, for all right-hand sides at once, on a GPU where there is one."""

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from tactorch.config import option
from tactorch.errors import ConfigError
from tactorch.linalg.solver import IterativeSolver, SolverOptions

_BLOCK = 3  # unknowns of a node


class TorchCGSolver(IterativeSolver):
    """Conjugate gradients, preconditioned by the inverse diagonal blocks of the nodes."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        device = self.options.device or ("cuda" if torch.cuda.is_available() else "cpu")
        if device.startswith("cuda") and not torch.cuda.is_available():
            raise ConfigError(f"solver.device={device}: there is no CUDA device; give cpu or null.")
        self._device = torch.device(device)

    def _factor(self, values: np.ndarray) -> bool:
        full, size = self.pattern.full(values), self.pattern.size
        block = _BLOCK if size % _BLOCK == 0 else 1
        unknowns = np.arange(size).reshape(-1, block, 1) + np.zeros(block, dtype=int)
        others = unknowns.swapaxes(1, 2)
        blocks = np.asarray(full[unknowns.ravel(), others.ravel()]).reshape(unknowns.shape)
        factors, info = torch.linalg.cholesky_ex(torch.from_numpy(blocks).to(self._device))
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

    def _solve(self, rhs: np.ndarray) -> np.ndarray:
        columns = torch.tensor(rhs, device=self._device).reshape(len(rhs), -1)
        with torch.no_grad():
            solution = self._iterate(self._matrix.matmul, self._precondition, columns)
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

"""Sparse symmetric solvers behind one small protocol: analyse once, factor, solve many."""

from tactorch.linalg.choose import BACKENDS, analyse, available
from tactorch.linalg.dense import DenseCholesky
from tactorch.linalg.lagged import lagged_solve
from tactorch.linalg.pattern import SymmetricPattern
from tactorch.linalg.pool import SolverPool
from tactorch.linalg.protocol import IndefiniteError, Solver, Status
from tactorch.linalg.threads import single_threaded

__all__ = [
    "BACKENDS",
    "DenseCholesky",
    "IndefiniteError",
    "Solver",
    "SolverPool",
    "Status",
    "SymmetricPattern",
    "analyse",
    "available",
    "lagged_solve",
    "single_threaded",
]

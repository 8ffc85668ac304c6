"""Sparse symmetric solvers behind one small protocol: analyse once, factor, solve many."""

from tactorch.linalg.choose import BACKENDS, analyse, available
from tactorch.linalg.dense import DenseCholesky
from tactorch.linalg.lagged import lagged_solve
from tactorch.linalg.pattern import SymmetricPattern
from tactorch.linalg.pool import SolverPool
from tactorch.linalg.protocol import IndefiniteError, Solver, Status
from tactorch.linalg.threads import single_threaded
from tactorch.linalg.vectors import column_rank, dot, norm

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
    "column_rank",
    "dot",
    "lagged_solve",
    "norm",
    "single_threaded",
]

"""Sparse symmetric solvers behind one protocol (analyse once, factor, solve many), and one CG."""

from tactorch.linalg.conjugate_gradients import CGResult, conjugate_gradients
from tactorch.linalg.dense import DenseCholesky, column_rank, dot
from tactorch.linalg.parallel import limit_workers, map_cases, single_threaded, worker_count
from tactorch.linalg.pattern import SymmetricPattern
from tactorch.linalg.pool import Lease, SolverPool
from tactorch.linalg.solver import (
    SOLVERS,
    IndefiniteError,
    Solver,
    SolverOptions,
    Status,
    analyse,
    available_solvers,
)

__all__ = [
    "SOLVERS",
    "CGResult",
    "DenseCholesky",
    "IndefiniteError",
    "Lease",
    "Solver",
    "SolverOptions",
    "SolverPool",
    "Status",
    "SymmetricPattern",
    "analyse",
    "available_solvers",
    "column_rank",
    "conjugate_gradients",
    "dot",
    "limit_workers",
    "map_cases",
    "single_threaded",
    "worker_count",
]

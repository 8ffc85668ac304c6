"""Sparse symmetric solvers behind one protocol (analyse once, factor, solve many), and one CG."""

from tactorch.linalg.conjugate_gradients import conjugate_gradients
from tactorch.linalg.dense import DenseCholesky
from tactorch.linalg.parallel import limit_workers, map_cases
from tactorch.linalg.pattern import SymmetricPattern
from tactorch.linalg.pool import SharedLease, SolverPool
from tactorch.linalg.solver import (
    SOLVERS,
    CoarseSpaces,
    Solver,
    SolverOptions,
    analyse,
    available_solvers,
)

__all__ = [
    "SOLVERS",
    "CoarseSpaces",
    "DenseCholesky",
    "SharedLease",
    "Solver",
    "SolverOptions",
    "SolverPool",
    "SymmetricPattern",
    "analyse",
    "available_solvers",
    "conjugate_gradients",
    "limit_workers",
    "map_cases",
]

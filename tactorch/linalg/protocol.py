"""What every sparse solver offers."""

from enum import Enum
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from tactorch.linalg.pattern import SymmetricPattern


class Status(Enum):
    """Outcome of a factorisation: a value, because an indefinite tangent is information."""

    OK = "positive definite"
    INDEFINITE = "not positive definite"


class IndefiniteError(ArithmeticError):
    """An iterative solver met a direction of negative curvature while solving."""


@runtime_checkable
class Factored(Protocol):
    """Anything that holds a factorisation."""

    def solve(self, rhs: Float[np.ndarray, "size *k"]) -> Float[np.ndarray, "size *k"]:
        """Solve with the last factorisation, for one or many right-hand sides."""
        ...


@runtime_checkable
class Solver(Factored, Protocol):
    """An analysed pattern that can be factored with new values any number of times.

    A solver keeps one factorisation at a time and belongs to one thread at a time; take several
    from a `SolverPool` to keep several factorisations.
    """

    name: str
    pattern: SymmetricPattern
    direct: bool  # whether a solve is cheap beside a factorisation
    single_precision: bool  # whether a solve is good to no more than a few digits

    def factor(self, values: Float[np.ndarray, " nnz"]) -> Status:
        """Factor the matrix with these upper-triangle values."""
        ...

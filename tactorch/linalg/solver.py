"""The protocol of sparse solvers, and the choice of one by name or by size."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from tactorch.config import Options, Registry
from tactorch.errors import ConfigError, ConvergenceError
from tactorch.linalg.conjugate_gradients import conjugate_gradients
from tactorch.linalg.pattern import SymmetricPattern

#: Linear solvers by name.
SOLVERS = Registry(
    "solver",
    {
        "auto": "tactorch.linalg.solver:AutoSolver",
        "pardiso": "tactorch.linalg.pardiso:Pardiso",
        "superlu": "tactorch.linalg.superlu:SuperLU",
        "multigrid": "tactorch.linalg.multigrid:Multigrid",
        "torch_cg": "tactorch.linalg.torch_cg:TorchCG",
    },
    "linear solvers",
)

# The factors of 3-D meshes grow as n^(4/3): beyond these sizes iteration is cheaper.
_MAX_PARDISO_SIZE = 500_000
_MAX_SUPERLU_SIZE = 60_000


class Status(Enum):
    """Outcome of a factorisation. An indefinite tangent is a result, not an error."""

    OK = "positive definite"
    INDEFINITE = "not positive definite"


class IndefiniteError(ArithmeticError):
    """An iterative solver met a direction of negative curvature."""


@runtime_checkable
class Solver(Protocol):
    """A symmetric sparse matrix whose pattern is analysed once and factored any number of times.

    A solver keeps one factorisation at a time and is used by one thread at a time; a `SolverPool`
    lends several.

    Attributes:
        pattern: Sparsity of the matrix.
        direct: Whether a solve is cheap compared with a factorisation.
        single_precision: Whether solutions are accurate to about four digits only.
    """

    pattern: SymmetricPattern
    direct: bool
    single_precision: bool

    def factor(self, values: Float[np.ndarray, " nnz"]) -> Status:
        """Factor the matrix with these upper-triangle values."""
        ...

    def solve(self, rhs: Float[np.ndarray, "size *k"]) -> Float[np.ndarray, "size *k"]:
        """Return the solution for one or many right-hand sides, with the last factorisation.

        Raises:
            IndefiniteError: An iterative solver met negative curvature.
            ConvergenceError: An iterative solver did not converge.
        """
        ...


class IterativeSolver:
    """Conjugate gradients with the limits of the solver's settings.

    Attributes:
        options: Settings with `rtol` and `max_iterations`.
    """

    direct = False
    single_precision = False
    options: Any

    def _iterate(
        self, product: Callable[[Any], Any], precondition: Callable[[Any], Any], rhs: Any
    ) -> Any:
        rtol, limit = self.options.rtol, self.options.max_iterations
        result = conjugate_gradients(product, precondition, rhs, rtol=rtol, max_iterations=limit)
        if result.negative_curvature:
            raise IndefiniteError("negative curvature: the matrix is not positive definite")
        if not result.converged:
            residual = rhs - result.image
            reached = float(abs(residual).max() / abs(rhs).max())
            name = SOLVERS.name_of(type(self.options))
            raise ConvergenceError(
                f"solver={name} did not converge: a relative residual of {reached:.1e}, not "
                f"{rtol:.0e}, in {limit} iterations; use solver=pardiso or solver=superlu, or "
                f"raise solver.max_iterations or solver.rtol."
            )
        return result.solution


@dataclass(frozen=True)
class SolverOptions(Options, ABC):
    """Settings of a linear solver.

    Attributes:
        has_single_precision: Whether it can factor in single precision.
        requires: Package that provides it.
    """

    section: ClassVar[str] = "solver"
    has_single_precision: ClassVar[bool] = False
    requires: ClassVar[str] = "scipy"

    @staticmethod
    def available() -> bool:
        """Return whether the solver's library is installed."""
        return True

    def resolve(self, size: int) -> "SolverOptions":
        """Return the settings of the solver for `size` unknowns.

        Raises:
            ConfigError: The solver is not installed.
        """
        if not self.available():
            name = SOLVERS.name_of(type(self))
            raise ConfigError(
                f"solver={name} is not installed; run `pip install {self.requires}`, or use "
                "solver=auto."
            )
        return self

    @abstractmethod
    def analyse(
        self,
        pattern: SymmetricPattern,
        near_nullspace: Float[np.ndarray, "size modes"] | None = None,
        single_precision: bool = False,
    ) -> Solver:
        """Analyse a sparsity pattern.

        Args:
            pattern: Upper triangle of the symmetric matrix.
            near_nullspace: Rigid-body modes, used by multigrid only.
            single_precision: Whether four digits suffice, for solvers that can make use of it.

        Returns:
            A solver, ready to factor matrices of this pattern.
        """


@dataclass(frozen=True)
class AutoSolver(SolverOptions):
    """PARDISO where it is installed, multigrid for the largest meshes, SuperLU elsewhere."""

    def resolve(self, size: int) -> SolverOptions:
        """Return the settings of the solver for `size` unknowns."""
        pardiso: SolverOptions = SOLVERS["pardiso"]()
        installed = pardiso.available()
        if size > (_MAX_PARDISO_SIZE if installed else _MAX_SUPERLU_SIZE):
            return SOLVERS["multigrid"]()
        return pardiso if installed else SOLVERS["superlu"]()

    def analyse(
        self,
        pattern: SymmetricPattern,
        near_nullspace: Float[np.ndarray, "size modes"] | None = None,
        single_precision: bool = False,
    ) -> Solver:
        """Analyse a sparsity pattern with the solver that suits its size."""
        solver = self.resolve(pattern.size)
        return solver.analyse(pattern, near_nullspace, single_precision)


def available_solvers() -> tuple[str, ...]:
    """Return the names of the solvers that can be used on this machine, without "auto"."""
    return tuple(n for n in SOLVERS.names() if n != "auto" and SOLVERS[n].available())


def analyse(pattern: SymmetricPattern, solver: str | SolverOptions = "auto") -> Solver:
    """Analyse a sparsity pattern with a solver, given by name or by its settings.

    Raises:
        ConfigError: The solver is unknown or not installed.
    """
    options: SolverOptions = SOLVERS.build(solver)
    return options.resolve(pattern.size).analyse(pattern)

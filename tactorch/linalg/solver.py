"""The protocol of sparse solvers, and the choice of one by name or by size."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float

from tactorch.config import Options, Registry
from tactorch.errors import ConfigError
from tactorch.linalg.pattern import SymmetricPattern

#: Linear solvers by name.
SOLVERS = Registry(
    "solver",
    {
        "auto": "tactorch.linalg.solver:AutoSolver",
        "pardiso": "tactorch.linalg.pardiso:Pardiso",
        "superlu": "tactorch.linalg.superlu:SuperLU",
        "multigrid": "tactorch.linalg.iterative:Multigrid",
        "p_multigrid": "tactorch.linalg.p_multigrid:PMultigrid",
        "torch_cg": "tactorch.linalg.iterative:TorchCG",
    },
)

# The factors of 3-D meshes grow as n^(4/3): beyond these sizes iteration is cheaper.
_MAX_PARDISO_SIZE = 500_000
_MAX_SUPERLU_SIZE = 60_000


class IndefiniteError(ArithmeticError):
    """An iterative solver met a direction of negative curvature."""


class CoarseSpaces(NamedTuple):
    """Fields that approximate slow errors of iterative solvers.

    Attributes:
        near_nullspace: Columns that the matrix nearly annihilates, such as rigid-body modes.
        linear: Interpolation from the unknowns of linear elements on the same mesh.
    """

    near_nullspace: Float[np.ndarray, "size modes"] | None = None
    linear: sp.csr_matrix | None = None


class Solver(ABC):
    """A symmetric sparse matrix whose pattern is analysed once and factored any number of times.

    A subclass defines `_factor` and `_solve`. A solver keeps one factorisation at a time and is
    used by one thread at a time; a `SolverPool` lends several.

    Attributes:
        options: Settings.
        pattern: Upper triangle of the symmetric matrix.
        near_nullspace: Columns that the matrix nearly annihilates, such as rigid-body modes.
        linear: Interpolation from the unknowns of linear elements on the same mesh.
        single_precision: Whether solutions are accurate to about four digits only.
        direct: Whether a solve is cheap compared with a factorisation.
        factored: Upper-triangle values of the factored matrix; None without a factorisation.
    """

    direct: ClassVar[bool] = True

    def __init__(
        self,
        options: Any,
        pattern: SymmetricPattern,
        coarse: CoarseSpaces | None = None,
        single_precision: bool = False,
    ) -> None:
        self.options, self.pattern = options, pattern
        self.near_nullspace, self.linear = coarse or CoarseSpaces()
        self.single_precision = single_precision
        self.factored: Float[np.ndarray, " nnz"] | None = None

    def factor(self, values: Float[np.ndarray, " nnz"]) -> bool:
        """Factor the matrix of these upper-triangle values.

        Returns:
            False if the matrix is found not positive definite. Iterative solvers may find this only
            when they solve, and do not where no residual meets negative curvature.
        """
        definite = bool(np.isfinite(values).all()) and self._factor(values)
        self.factored = values if definite else None
        return definite

    def solve(
        self, rhs: Float[np.ndarray, "size *k"], rtol: float = 0.0
    ) -> Float[np.ndarray, "size *k"]:
        """Return the solution for one or many right-hand sides, with the last factorisation.

        Args:
            rhs: Right-hand sides.
            rtol: Relative residual that suffices, for iterative solvers.

        Raises:
            IndefiniteError: An iterative solver met negative curvature.
            RuntimeError: There is no factorisation.
        """
        if self.factored is None:
            raise RuntimeError("factor a positive definite matrix before solving")
        return self._solve(rhs, rtol)

    @abstractmethod
    def _factor(self, values: np.ndarray) -> bool: ...

    @abstractmethod
    def _solve(self, rhs: np.ndarray, rtol: float) -> np.ndarray: ...


@dataclass(frozen=True)
class SolverOptions(Options):
    """Settings of a linear solver.

    Attributes:
        solver: Class of the solver, made with these settings.
        has_single_precision: Whether it can factor in single precision.
        requires: Package that provides it.
    """

    section: ClassVar[str] = "solver"
    solver: ClassVar[type[Solver]]
    has_single_precision: ClassVar[bool] = False
    requires: ClassVar[str] = "scipy"

    @staticmethod
    def available() -> bool:
        """Return whether the solver's library is installed."""
        return True

    def resolve(self, size: int) -> "SolverOptions":
        """Return the settings of the solver for `size` unknowns, or raise ConfigError."""
        if not self.available():
            name = SOLVERS.name_of(type(self))
            raise ConfigError(
                f"solver={name} is not installed; run `pip install {self.requires}`, or use "
                "solver=auto."
            )
        return self

    def analyse(
        self,
        pattern: SymmetricPattern,
        coarse: CoarseSpaces | None = None,
        single_precision: bool = False,
    ) -> Solver:
        """Return a solver for a sparsity pattern; see `Solver` for the arguments."""
        options = self.resolve(pattern.size)
        single_precision = single_precision and options.has_single_precision
        return options.solver(options, pattern, coarse, single_precision)


@dataclass(frozen=True)
class AutoSolver(SolverOptions):
    """PARDISO where it is installed, multigrid for the largest meshes, SuperLU elsewhere."""

    def resolve(self, size: int) -> SolverOptions:
        direct = direct_solver()
        if size > (_MAX_SUPERLU_SIZE if direct.requires == "scipy" else _MAX_PARDISO_SIZE):
            return SOLVERS["multigrid"]()
        return direct


def direct_solver() -> SolverOptions:
    """Return PARDISO where it is installed, SuperLU elsewhere."""
    pardiso: SolverOptions = SOLVERS["pardiso"]()
    return pardiso if pardiso.available() else SOLVERS["superlu"]()


def available_solvers() -> tuple[str, ...]:
    """Return the names of tactorch's solvers that can be used on this machine, without "auto"."""
    return tuple(n for n in SOLVERS.builtin() if n != "auto" and SOLVERS[n].available())


def analyse(
    pattern: SymmetricPattern,
    solver: str | SolverOptions = "auto",
    *,
    single_precision: bool = False,
) -> Solver:
    """Return a solver, given by name or by its settings, for a sparsity pattern."""
    options: SolverOptions = SOLVERS.build(solver)
    return options.analyse(pattern, single_precision=single_precision)

"""PARDISO of Intel MKL, through the library that pypardiso finds.

The phases (analyse, factor, solve) are called separately on the upper triangle of the matrix.
The factorisation is Cholesky's: error -4 means that the matrix is not positive definite.
Reference: oneMKL developer reference, "pardiso" (iparm table).
"""

import ctypes
import os
import weakref
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, files
from typing import Any, ClassVar

import numpy as np

from tactorch.errors import TactorchError
from tactorch.linalg.pattern import SymmetricPattern
from tactorch.linalg.solver import Solver, SolverOptions

_PATH = "PYPARDISO_MKL_RT"
_CHOLESKY = 2
_ANALYSE, _FACTOR, _SOLVE, _RELEASE = 11, 22, 33, -1
_NOT_POSITIVE_DEFINITE = -4
_ERRORS = {-1: "inconsistent input", -2: "not enough memory", -3: "reordering failed",
           -8: "32-bit index overflow"}  # fmt: skip


@cache
def _library() -> Any | None:
    """MKL, loaded once; None where pypardiso or its library is not installed."""
    try:
        paths = [str(file.locate()) for file in files("mkl") or () if "mkl_rt" in file.name]
    except PackageNotFoundError:
        paths = []
    # Without the path of the library pypardiso searches the environment for several seconds.
    given = len(paths) == 1 and _PATH not in os.environ
    if given:
        os.environ[_PATH] = paths[0]
    try:
        from pypardiso import ps

        return ps.libmkl
    except (ImportError, OSError):
        return None
    finally:
        if given:
            del os.environ[_PATH]


def set_local_threads(count: int) -> int:
    """Set MKL's thread count for the calling thread (0: the default); return the previous one."""
    return int(_library().MKL_Set_Num_Threads_Local(ctypes.c_int(count)))  # type: ignore[union-attr]


@cache
def _entry() -> Any:
    """PARDISO's entry point, without the argument types that pypardiso declares."""
    function = _library()["pardiso"]  # type: ignore[index]
    function.restype = None
    return function


def _int(value: int) -> Any:
    return ctypes.byref(ctypes.c_int32(value))


def _call(
    pt: np.ndarray, iparm: np.ndarray, phase: int, pattern: SymmetricPattern, *arrays: np.ndarray
) -> int:
    """Run one phase with (values, rhs, out); return PARDISO's error code."""
    error = ctypes.c_int32(0)
    pointer = ctypes.c_void_p
    values, rhs, out = arrays
    _entry()(
        pointer(pt.ctypes.data), _int(1), _int(1), _int(_CHOLESKY), _int(phase),
        _int(pattern.size), pointer(values.ctypes.data),
        pointer(pattern.indptr.ctypes.data), pointer(pattern.indices.ctypes.data),
        pointer(0), _int(1 if rhs.ndim == 1 else rhs.shape[1]), pointer(iparm.ctypes.data),
        _int(0), pointer(rhs.ctypes.data), pointer(out.ctypes.data), ctypes.byref(error),
    )  # fmt: skip
    return error.value


class PardisoSolver(Solver):
    """Sparse Cholesky, in single precision for preconditioning.

    Single precision takes two thirds of the time and half the memory, for about four digits.
    """

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._type = np.float32 if self.single_precision else np.float64
        self._pt = np.zeros(64, dtype=np.int64)
        self._iparm = np.zeros(64, dtype=np.int32)
        self._iparm[0] = 1  # use the values below instead of the defaults
        self._iparm[1] = 2  # nested dissection (METIS)
        self._iparm[27] = int(self.single_precision)
        self._iparm[34] = 1  # indices count from zero
        none = self._none = np.zeros(1, dtype=self._type)
        # The analysis (fill-reducing order, symbolic factorisation) reads no values.
        self._run(_ANALYSE, np.ones(self.pattern.nnz, dtype=self._type), none, none)
        release = (self._pt, self._iparm, _RELEASE, self.pattern, none, none, none)
        self._finalizer = weakref.finalize(self, _call, *release)

    def _run(self, phase: int, *arrays: np.ndarray) -> int:
        # MKL fails where threads of one number analyse a matrix and of another one factor it, as
        # load cases that take the solver from a pool may. They use the cores side by side.
        previous = set_local_threads(1)
        try:
            code = _call(self._pt, self._iparm, phase, self.pattern, *arrays)
        finally:
            set_local_threads(previous)
        if code not in (0, _NOT_POSITIVE_DEFINITE):
            raise TactorchError(
                f"solver=pardiso failed with error {code} ({_ERRORS.get(code, 'see MKL')}) at "
                f"{self.pattern.size} unknowns; use solver=superlu or solver=multigrid."
            )
        return code

    def _factor(self, values: np.ndarray) -> bool:
        self._values = np.ascontiguousarray(values, dtype=self._type)
        return self._run(_FACTOR, self._values, self._none, self._none) == 0

    def _solve(self, rhs: np.ndarray, _rtol: float) -> np.ndarray:
        # Small residuals are outside the range of single precision.
        unit = (float(np.abs(rhs).max()) or 1.0) if self.single_precision else 1.0
        b = np.asfortranarray(rhs / unit if self.single_precision else rhs, dtype=self._type)
        out = np.empty_like(b, order="F")
        self._run(_SOLVE, self._values, b, out)
        return out.astype(np.float64) * unit if self.single_precision else out


@dataclass(frozen=True)
class Pardiso(SolverOptions):
    """Intel's direct solver, on x86-64."""

    solver = PardisoSolver
    has_single_precision: ClassVar[bool] = True
    requires: ClassVar[str] = "pypardiso"

    @staticmethod
    def available() -> bool:
        return _library() is not None

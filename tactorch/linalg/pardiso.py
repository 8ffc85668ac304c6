"""PARDISO of Intel MKL, through the library that pypardiso finds.

The phases (analyse, factor, solve) are called separately on the upper triangle of the matrix.
The factorisation is Cholesky's: error -4 means that the matrix is not positive definite.
Reference: oneMKL developer reference, "pardiso" (iparm table).
"""

import ctypes
import os
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, files
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from tactorch.errors import TactorchError
from tactorch.linalg.pattern import SymmetricPattern
from tactorch.linalg.solver import SolverOptions, Status

_CHOLESKY = 2
_ANALYSE, _FACTOR, _SOLVE, _RELEASE = 11, 22, 33, -1
_NOT_POSITIVE_DEFINITE = -4
# Below this size threads gain little, and their barriers cost tens of milliseconds a call as soon
# as another process wants a core.
_MIN_PARALLEL_SIZE = 15_000
_ERRORS = {
    -1: "inconsistent input",
    -2: "not enough memory",
    -3: "reordering failed",
    -8: "32-bit index overflow",
}


@cache
def _library() -> Any | None:
    """MKL, loaded once; None where pypardiso or its library is not installed."""
    try:
        with _library_path():
            from pypardiso import ps
        return ps.libmkl
    except (ImportError, OSError):
        return None


@contextmanager
def _library_path() -> Iterator[None]:
    """Set the path of the library that pip installed; pypardiso searches for several seconds."""
    name = "PYPARDISO_MKL_RT"
    try:
        paths = [str(file.locate()) for file in files("mkl") or () if "mkl_rt" in file.name]
    except PackageNotFoundError:
        paths = []
    if name in os.environ or len(paths) != 1:
        yield
        return
    os.environ[name] = paths[0]
    try:
        yield
    finally:
        del os.environ[name]


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


def _call(pt: np.ndarray, iparm: np.ndarray, phase: int, arrays: dict[str, Any]) -> int:
    """Run one phase; return PARDISO's error code."""
    error = ctypes.c_int32(0)
    pattern: SymmetricPattern = arrays["pattern"]
    rhs, out = arrays["rhs"], arrays["out"]
    pointer = ctypes.c_void_p
    _entry()(
        pointer(pt.ctypes.data), _int(1), _int(1), _int(_CHOLESKY), _int(phase),
        _int(pattern.size), pointer(arrays["values"].ctypes.data),
        pointer(pattern.indptr.ctypes.data), pointer(pattern.indices.ctypes.data),
        pointer(0), _int(1 if rhs.ndim == 1 else rhs.shape[1]), pointer(iparm.ctypes.data),
        _int(0), pointer(rhs.ctypes.data), pointer(out.ctypes.data), ctypes.byref(error),
    )  # fmt: skip
    return error.value


@dataclass(frozen=True)
class Pardiso(SolverOptions):
    """Intel's direct solver, on x86-64."""

    has_single_precision: ClassVar[bool] = True
    requires: ClassVar[str] = "pypardiso"

    @staticmethod
    def available() -> bool:
        """Return whether pypardiso and its MKL library are installed."""
        return _library() is not None

    def analyse(
        self,
        pattern: SymmetricPattern,
        near_nullspace: Float[np.ndarray, "size modes"] | None = None,
        single_precision: bool = False,
    ) -> "PardisoSolver":
        """See `SolverOptions.analyse`."""
        return PardisoSolver(pattern, single_precision)


class PardisoSolver:
    """Sparse Cholesky; see `tactorch.linalg.Solver`.

    Args:
        pattern: The matrix pattern.
        single_precision: Whether to factor in single precision, for preconditioning: two thirds
            of the time, half the memory, about four digits.

    Raises:
        TactorchError: PARDISO failed for a reason other than indefiniteness, such as memory.
    """

    direct = True

    def __init__(self, pattern: SymmetricPattern, single_precision: bool = False) -> None:
        self.pattern = pattern
        self.single_precision = single_precision
        self._type: type[np.floating] = np.float32 if single_precision else np.float64
        self._pt = np.zeros(64, dtype=np.int64)
        self._iparm = np.zeros(64, dtype=np.int32)
        self._iparm[0] = 1  # use the values below instead of the defaults
        self._iparm[1] = 2  # nested dissection (METIS)
        self._iparm[27] = int(single_precision)
        self._iparm[34] = 1  # indices count from zero
        none = self._none = np.zeros(1, dtype=self._type)
        empty = {"pattern": pattern, "values": none, "rhs": none, "out": none}
        # The analysis (fill-reducing order, symbolic factorisation) reads no values.
        self._run(_ANALYSE, np.ones(pattern.nnz, dtype=self._type), none, none)
        self._values = none
        self._finalizer = weakref.finalize(self, _call, self._pt, self._iparm, _RELEASE, empty)

    def _run(self, phase: int, values: np.ndarray, rhs: np.ndarray, out: np.ndarray) -> int:
        arrays = {"pattern": self.pattern, "values": values, "rhs": rhs, "out": out}
        small = self.pattern.size < _MIN_PARALLEL_SIZE
        previous = set_local_threads(1) if small else 0
        try:
            code = _call(self._pt, self._iparm, phase, arrays)
        finally:
            if small:
                set_local_threads(previous)
        if code not in (0, _NOT_POSITIVE_DEFINITE):
            raise TactorchError(
                f"solver=pardiso failed with error {code} ({_ERRORS.get(code, 'see MKL')}) at "
                f"{self.pattern.size} unknowns; use solver=superlu or solver=multigrid."
            )
        return code

    def factor(self, values: Float[np.ndarray, " nnz"]) -> Status:
        """Factor the matrix; an indefinite one is reported, not raised."""
        if not np.all(np.isfinite(values)):
            return Status.INDEFINITE
        self._values = np.ascontiguousarray(values, dtype=self._type)
        code = self._run(_FACTOR, self._values, self._none, self._none)
        return Status.INDEFINITE if code == _NOT_POSITIVE_DEFINITE else Status.OK

    def solve(self, rhs: Float[np.ndarray, "size *k"]) -> Float[np.ndarray, "size *k"]:
        """Return the solution for all columns of `rhs`, in one call."""
        # Small residuals are outside the range of single precision.
        unit = (float(np.abs(rhs).max()) or 1.0) if self.single_precision else 1.0
        b = np.asfortranarray(rhs / unit if self.single_precision else rhs, dtype=self._type)
        out = np.empty_like(b, order="F")
        self._run(_SOLVE, self._values, b, out)
        return out.astype(np.float64) * unit if self.single_precision else out

"""The choice of a solver by name, or by size."""

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.linalg import pardiso
from tactorch.linalg.multigrid import Multigrid
from tactorch.linalg.pattern import SymmetricPattern
from tactorch.linalg.protocol import Solver
from tactorch.linalg.superlu import SuperLU

BACKENDS = ("auto", "pardiso", "superlu", "multigrid")

# Factors of 3-D meshes grow as n^(4/3): past these sizes the iteration is the cheaper way.
_PARDISO_LIMIT = 500_000
_SUPERLU_LIMIT = 60_000


def available() -> tuple[str, ...]:
    """Names of the backends that can be used on this machine."""
    return ("pardiso", *BACKENDS[2:]) if pardiso.available() else BACKENDS[2:]


def resolve(backend: str, size: int) -> str:
    """Turn `auto` into a name.

    Raises:
        ConfigError: the name is unknown, or PARDISO was asked for and is not installed.
    """
    if backend not in BACKENDS:
        raise ConfigError(f"solver={backend} is unknown; choose one of {', '.join(BACKENDS)}.")
    if backend == "pardiso" and not pardiso.available():
        raise ConfigError(
            "solver=pardiso needs the package pypardiso and its MKL library, which are not "
            "installed; run `pip install pypardiso`, or use solver=auto."
        )
    if backend != "auto":
        return backend
    if pardiso.available() and size <= _PARDISO_LIMIT:
        return "pardiso"
    return "superlu" if size <= _SUPERLU_LIMIT and not pardiso.available() else "multigrid"


def analyse(
    pattern: SymmetricPattern,
    backend: str = "auto",
    near_nullspace: Float[np.ndarray, "size modes"] | None = None,
    single_precision: bool = False,
) -> Solver:
    """Analyse a pattern with the chosen backend.

    Args:
        pattern: Upper triangle of the symmetric matrix.
        backend: One of `BACKENDS`.
        near_nullspace: Rigid-body modes, used by multigrid alone.
        single_precision: Whether four digits suffice; only PARDISO supports it.

    Raises:
        ConfigError: the backend is unknown or not installed.
    """
    name = resolve(backend, pattern.size)
    if name == "pardiso":
        return pardiso.Pardiso(pattern, single_precision)
    if name == "superlu":
        return SuperLU(pattern)
    return Multigrid(pattern, near_nullspace)

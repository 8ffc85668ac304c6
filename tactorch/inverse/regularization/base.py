"""What a prior is: a penalty on the logarithm of Young's modulus.

Priors act on log-moduli whatever the parameterisation, since tissue differs by factors.
"""

from abc import ABC, abstractmethod
from typing import Protocol, runtime_checkable

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.mesh import TetMesh


@runtime_checkable
class Regularizer(Protocol):
    """Penalty on a field of log-moduli, one value an element."""

    name: str

    def value(self, field: Float[np.ndarray, " m"]) -> float:
        """Return the penalty (dimensionless)."""
        ...

    def gradient(self, field: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Return the penalty's gradient."""
        ...

    def curvature(self, field: Float[np.ndarray, " m"]) -> sp.csr_matrix:
        """Return a positive semi-definite matrix that stands for the penalty's Hessian.

        Where it can be, it is a majorant's: the quadratic with this Hessian and the penalty's
        value and gradient at `field` lies nowhere below the penalty.
        """
        ...


class NoPrior:
    """The absence of a prior."""

    name = "none"

    def __init__(self, mesh: TetMesh) -> None:
        """Take the mesh for the number of elements."""
        self._size = mesh.n_tets

    def value(self, field: Float[np.ndarray, " m"]) -> float:
        """Return zero."""
        return 0.0

    def gradient(self, field: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Return zeros."""
        return np.zeros_like(field)

    def curvature(self, field: Float[np.ndarray, " m"]) -> sp.csr_matrix:
        """Return an empty matrix."""
        return sp.csr_matrix((self._size, self._size))


def jumps(mesh: TetMesh) -> sp.csr_matrix:
    """Return the matrix that takes a field to its jumps across interior faces, (faces, m)."""
    pairs = mesh.adjacency.pairs
    faces = np.arange(len(pairs))
    ones = np.ones(len(pairs))
    return sp.csr_matrix(
        (
            np.concatenate([ones, -ones]),
            (np.concatenate([faces, faces]), np.concatenate([pairs[:, 0], pairs[:, 1]])),
        ),
        shape=(len(pairs), mesh.n_tets),
    )


def relative_areas(mesh: TetMesh) -> Float[np.ndarray, " faces"]:
    """Areas of interior faces over their mean."""
    areas = mesh.adjacency.areas
    return areas / areas.mean() if len(areas) else areas


class JumpPenalty(ABC):
    """A penalty on the size of jumps, lowered by reweighted least squares.

    The curvature at a field is the Hessian of the quadratic that touches the penalty there from
    above, which exists where the penalty is concave in the squared jump.

    Args:
        mesh: The object.
        edge: Jump of log-modulus at which the penalty turns from smooth to sharp.

    Raises:
        ConfigError: `edge` is not positive.
    """

    def __init__(self, mesh: TetMesh, edge: float) -> None:
        """Assemble the jumps."""
        if not edge > 0:
            raise ConfigError(f"regularization.edge={edge} must be above 0 (log-modulus).")
        self.edge = edge
        self._jumps = jumps(mesh)
        self._areas = relative_areas(mesh)

    @abstractmethod
    def _weights(self, jump: Float[np.ndarray, " faces"]) -> Float[np.ndarray, " faces"]:
        """Derivative of each face's penalty by its jump, over the jump."""

    def gradient(self, field: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Return the penalty's gradient."""
        jump = self._jumps @ field
        return self._jumps.T @ (self._weights(jump) * jump)

    def curvature(self, field: Float[np.ndarray, " m"]) -> sp.csr_matrix:
        """Return the majorant at `field`."""
        weights = sp.diags(self._weights(self._jumps @ field))
        return (self._jumps.T @ weights @ self._jumps).tocsr()

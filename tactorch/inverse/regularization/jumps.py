"""Penalties on jumps of the log-modulus across interior faces."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float

from tactorch.config import option
from tactorch.inverse.regularization.base import Prior, Quadratic, Regularizer
from tactorch.mesh import TetMesh


def jumps(mesh: TetMesh) -> sp.csr_matrix:
    """Return the matrix that maps a field to its jumps across interior faces, (faces, m)."""
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
    """Return areas of interior faces over their mean."""
    areas = mesh.adjacency.areas
    return areas / areas.mean() if len(areas) else areas


_Function = Callable[[np.ndarray], np.ndarray]


class JumpPenalty(Regularizer):
    """Sum over interior faces of area * cost(jump), minimised by reweighted least squares.

    The curvature at a field belongs to the quadratic majorant that touches the penalty there. It
    exists where the cost is concave in the squared jump.

    Args:
        mesh: The object.
        edge: Jump of log-modulus at which the cost changes from quadratic to sharp.
        cost: Cost of each jump.
        stiffness: Derivative of the cost by the jump, over the jump.
        is_variation: Whether the cost is that of total variation.
    """

    def __init__(
        self,
        mesh: TetMesh,
        edge: float,
        cost: _Function,
        stiffness: _Function,
        *,
        is_variation: bool = False,
    ) -> None:
        """Assemble the jumps."""
        self.edge, self._cost, self._stiffness = edge, cost, stiffness
        self._jumps, self._areas = jumps(mesh), relative_areas(mesh)
        self.variation = self if is_variation else None

    def value(self, field: Float[np.ndarray, " m"]) -> float:
        """Return the penalty, zero for a uniform field."""
        return float(self._areas @ self._cost(self._jumps @ field))

    def gradient(self, field: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Return the gradient of the penalty."""
        jump = self._jumps @ field
        return self._jumps.T @ (self._areas * self._stiffness(jump) * jump)

    def curvature(self, field: Float[np.ndarray, " m"]) -> sp.csr_matrix:
        """Return the Hessian of the majorant at `field`."""
        weights = sp.diags(self._areas * self._stiffness(self._jumps @ field))
        return (self._jumps.T @ weights @ self._jumps).tocsr()


@dataclass(frozen=True, kw_only=True)
class TotalVariation(Prior):
    """Total variation: sharp edges.

    Sum over interior faces of area * (sqrt(jump^2 + edge^2) - edge), in mean areas. Reweighted
    least squares is lagged diffusivity (Vogel and Oman, 1996).

    Attributes:
        edge: Jump of log-modulus below which the penalty is quadratic.
    """

    edge: float = option(0.03, "Jump of log-modulus below which the penalty is quadratic", gt=0)

    def on(self, mesh: TetMesh) -> JumpPenalty:
        """Return the penalty on a mesh."""

        def size(jump: np.ndarray) -> np.ndarray:
            return np.sqrt(jump * jump + self.edge**2)

        return JumpPenalty(
            mesh,
            self.edge,
            lambda jump: size(jump) - self.edge,
            lambda jump: 1.0 / size(jump),
            is_variation=True,
        )


@dataclass(frozen=True, kw_only=True)
class LogJumps(Prior):
    """Logarithm of jumps: keeps contrast better than total variation, but is not convex.

    Sum over interior faces of area * edge * log(1 + (jump / edge)^2), in mean areas: the
    Lorentzian of Black and Rangarajan (1996). Its force on a jump falls as the jump grows.

    Attributes:
        edge: Jump of log-modulus at which the force is largest.
    """

    edge: float = option(0.1, "Jump of log-modulus at which the force is largest", gt=0)

    def on(self, mesh: TetMesh) -> JumpPenalty:
        """Return the penalty on a mesh."""
        edge = self.edge
        return JumpPenalty(
            mesh,
            edge,
            lambda jump: edge * np.log1p((jump / edge) ** 2),
            lambda jump: 2.0 * edge / (edge**2 + jump * jump),
        )


@dataclass(frozen=True, kw_only=True)
class Smoothness(Prior):
    """First-order smoothness: the squared gradient, which blurs edges.

    Half the sum over interior faces of area / distance * jump^2, in units of the mean face, a
    finite-volume approximation of half the integral of the squared gradient.
    """

    def on(self, mesh: TetMesh) -> Quadratic:
        """Return the penalty on a mesh."""
        distances = mesh.adjacency.distances
        relative = distances / distances.mean() if len(distances) else distances
        difference = jumps(mesh)
        return Quadratic(difference.T @ sp.diags(relative_areas(mesh) / relative) @ difference)

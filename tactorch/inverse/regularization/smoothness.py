"""First-order smoothness: the squared gradient of the field, by finite volumes."""

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float

from tactorch.inverse.regularization.base import jumps, relative_areas
from tactorch.mesh import TetMesh


class Smoothness:
    """Half the sum over interior faces of area / distance * jump^2, in mean-face units.

    This approximates half the integral of the squared gradient; it blurs edges.
    """

    name = "smoothness"

    def __init__(self, mesh: TetMesh) -> None:
        """Assemble the constant matrix."""
        distances = mesh.adjacency.distances
        relative = distances / distances.mean() if len(distances) else distances
        difference = jumps(mesh)
        self._matrix = (
            difference.T @ sp.diags(relative_areas(mesh) / relative) @ difference
        ).tocsr()

    def value(self, field: Float[np.ndarray, " m"]) -> float:
        """Return the penalty."""
        return 0.5 * float(field @ (self._matrix @ field))

    def gradient(self, field: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Return the penalty's gradient."""
        return self._matrix @ field

    def curvature(self, field: Float[np.ndarray, " m"]) -> sp.csr_matrix:
        """Return the Hessian, which is constant."""
        return self._matrix

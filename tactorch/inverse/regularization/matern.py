"""A Gaussian prior with Matern covariance, through a sparse precision (the SPDE approach)."""

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float
from scipy.sparse.linalg import splu

from tactorch.errors import ConfigError
from tactorch.inverse.regularization.base import jumps
from tactorch.inverse.regularization.levels import log_level, relative_volumes
from tactorch.mesh import TetMesh


class Matern:
    """Half of (f - mean)^T Q (f - mean), the negative logarithm of a Gaussian density; f = log e.

    (kappa^2 - Laplacian) tau f = white noise, by finite volumes on the elements, has precision
    Q = tau^2 (kappa^2 C + G) C^-1 (kappa^2 C + G), with C the volumes and G the jumps' squares by
    area / distance (Lindgren, Rue and Lindstrom, 2011). In three dimensions the covariance is
    deviation^2 exp(-r kappa): smoothness 1/2, correlation 0.14 at r = `length_mm` = 2 / kappa.
    No flux leaves the surface, so the deviation is larger within a length of it.

    With weight 1 it is the prior as stated.

    Args:
        mesh: The object.
        length_mm: Distance at which the correlation has fallen to 0.14, mm.
        deviation: Standard deviation of the log-modulus.
        level_mpa: Mean, MPa: one modulus, or one an element; None takes the field's own
            volume-weighted mean (of logarithms), which makes the penalty smallest.

    Raises:
        ConfigError: a setting is not positive, or the shape of the level is wrong.
    """

    name = "matern"

    def __init__(
        self,
        mesh: TetMesh,
        length_mm: float = 3.0,
        deviation: float = 0.5,
        level_mpa: float | Float[np.ndarray, " m"] | None = None,
    ) -> None:
        """Assemble the constant precision."""
        for name, value in (("length_mm", length_mm), ("deviation", deviation)):
            if not 0 < value < np.inf:
                raise ConfigError(f"regularization.{name}={value} must be above 0.")
        self._level = log_level(level_mpa, mesh.n_tets)
        self._volumes = relative_volumes(mesh)
        kappa = 2.0 / length_mm
        scale = 1.0 / (8.0 * np.pi * kappa * deviation**2)  # tau^2, Lindgren et al., eq. (4)
        difference, faces = jumps(mesh), mesh.adjacency
        flux = difference.T @ sp.diags(faces.areas / faces.distances) @ difference
        self._operator = (kappa**2 * sp.diags(mesh.volumes) + flux).tocsc()
        self._root = np.sqrt(mesh.volumes / scale)
        precision = scale * self._operator @ sp.diags(1.0 / mesh.volumes) @ self._operator
        self._precision = (0.5 * (precision + precision.T)).tocsr()

    def _distance(self, field: np.ndarray) -> np.ndarray:
        # The uniform field is an eigenvector of Q C^-1: the best mean is weighted by volume.
        level = np.average(field, weights=self._volumes) if self._level is None else self._level
        return field - level

    def value(self, field: Float[np.ndarray, " m"]) -> float:
        """Return the penalty, zero at the mean."""
        distance = self._distance(field)
        return 0.5 * float(distance @ (self._precision @ distance))

    def gradient(self, field: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Return the penalty's gradient."""
        return self._precision @ self._distance(field)

    def curvature(self, field: Float[np.ndarray, " m"]) -> sp.csr_matrix:
        """Return the precision; a majorant where the mean follows the field."""
        return self._precision

    def sample(self, rng: np.random.Generator) -> Float[np.ndarray, " m"]:
        """Draw a map, MPa; for `starts.monte_carlo`, say.

        Raises:
            ConfigError: the prior has no mean of its own.
        """
        if self._level is None:
            raise ConfigError("regularization.level_mpa is null: give a mean to draw maps around.")
        white = self._root * rng.standard_normal(len(self._root))
        return np.exp(self._level + splu(self._operator).solve(white))

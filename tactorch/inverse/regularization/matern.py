"""A Gaussian prior with Matern covariance, by a sparse precision matrix (SPDE approach)."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float
from scipy.sparse.linalg import splu

from tactorch.config import option
from tactorch.errors import ConfigError
from tactorch.inverse.regularization.base import Prior, Quadratic, log_level, relative_volumes
from tactorch.inverse.regularization.jumps import jumps
from tactorch.mesh import TetMesh


@dataclass(frozen=True, kw_only=True)
class Matern(Prior):
    """Gaussian with Matern covariance; weight 1 is the prior as stated.

    Half of (f - mean)^T Q (f - mean), f = log E: the negative logarithm of a Gaussian density. Q
    discretises (kappa^2 - Laplacian)^2 by finite volumes, with the Laplacian from the faces by
    area / distance (Lindgren, Rue and Lindstrom, 2011). In three dimensions the covariance is
    deviation^2 exp(-r kappa): smoothness 1/2, correlation 0.14 at r = `length_mm` = 2 / kappa.
    No flux crosses the surface, so the deviation is larger within one length of it.

    Attributes:
        length_mm: Distance at which the correlation has fallen to 0.14, mm.
        deviation: Standard deviation of the log-modulus.
        level_mpa: Mean, MPa; None takes the field's volume-weighted mean of logarithms, which
            minimises the penalty.
    """

    length_mm: float = option(
        3.0, "Distance at which the correlation has fallen to 0.14", unit="mm", gt=0
    )
    deviation: float = option(0.5, "Standard deviation of the log-modulus", gt=0)
    level_mpa: float | None = option(
        None, "Mean modulus; null: that of the present map", unit="MPa", gt=0
    )

    def on(self, mesh: TetMesh) -> "MaternPenalty":
        """Return the penalty on a mesh."""
        kappa = 2.0 / self.length_mm
        scale = 1.0 / (8.0 * np.pi * kappa * self.deviation**2)  # tau^2, Lindgren et al., eq. (4)
        difference, faces = jumps(mesh), mesh.adjacency
        flux = difference.T @ sp.diags(faces.areas / faces.distances) @ difference
        operator = (kappa**2 * sp.diags(mesh.volumes) + flux).tocsc()
        precision = scale * operator @ sp.diags(1.0 / mesh.volumes) @ operator
        return MaternPenalty(
            (0.5 * (precision + precision.T)).tocsr(),
            log_level(self.level_mpa),
            relative_volumes(mesh),  # the uniform field is an eigenvector of Q C^-1
            operator,
            np.sqrt(mesh.volumes / scale),
        )


class MaternPenalty(Quadratic):
    """The penalty of `Matern` on a mesh, which draws maps too."""

    def __init__(
        self,
        precision: sp.csr_matrix,
        level: float | None,
        volumes: Float[np.ndarray, " m"],
        operator: sp.csc_matrix,
        root: Float[np.ndarray, " m"],
    ) -> None:
        """Store the precision Q = operator diag(root)^-2 operator."""
        super().__init__(precision, level, volumes)
        self._operator, self._root = operator, root

    def sample(self, rng: np.random.Generator) -> Float[np.ndarray, " m"]:
        """Draw a map, MPa, for example for `tactorch.inverse.monte_carlo`.

        Raises:
            ConfigError: the prior has no given mean.
        """
        if self._level is None:
            raise ConfigError("regularization.level_mpa is null: give a mean to draw maps around.")
        white = self._root * rng.standard_normal(len(self._root))
        return np.exp(self._level + splu(self._operator).solve(white))

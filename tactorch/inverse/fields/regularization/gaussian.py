"""Quadratic penalties: smoothness, Tikhonov's, and the Gaussian density with Matern covariance."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from tactorch.config import option
from tactorch.errors import ConfigError
from tactorch.inverse.fields.regularization.base import (
    Field,
    LevelPrior,
    Prior,
    Quadratic,
    jumps,
    relative,
)
from tactorch.mesh import TetMesh


@dataclass(frozen=True, kw_only=True)
class Smoothness(Prior):
    """First-order smoothness: the squared gradient, which blurs edges.

    Half the sum over interior faces of area / distance * jump^2, in units of the mean face, a
    finite-volume approximation of half the integral of the squared gradient.
    """

    def on(self, mesh: TetMesh) -> Quadratic:
        faces, difference = mesh.adjacency, jumps(mesh)
        weights = relative(faces.areas) / relative(faces.distances)
        return Quadratic(difference.T @ sp.diags(weights) @ difference)


@dataclass(frozen=True, kw_only=True)
class Tikhonov(LevelPrior):
    """Tikhonov: squared difference from a reference modulus.

    Half the sum over elements of volume * (log E - log reference)^2, in mean volumes. The mean of
    the present map is that of the log-moduli, by volume.
    """

    def on(self, mesh: TetMesh) -> Quadratic:
        volumes = relative(mesh.volumes)
        return Quadratic(sp.diags(volumes), self.level(mesh), volumes)


@dataclass(frozen=True, kw_only=True)
class Matern(LevelPrior):
    """Gaussian with Matern covariance; weight 1 is the prior as stated.

    Half of (f - mean)^T Q (f - mean), f = log E: the negative logarithm of a Gaussian density. Q
    discretises (kappa^2 - Laplacian)^2 by finite volumes, with the Laplacian from the faces by
    area / distance (Lindgren, Rue and Lindstrom, 2011). In three dimensions the covariance is
    deviation^2 exp(-r kappa): smoothness 1/2, correlation 0.14 at r = `length_mm` = 2 / kappa.
    No flux crosses the surface, so the deviation is larger within one length of it. The mean of the
    present map is that of the log-moduli, by volume, which minimises the penalty.
    """

    length_mm: float = option(
        3.0, "Distance at which the correlation has fallen to 0.14", unit="mm", gt=0
    )
    deviation: float = option(0.5, "Standard deviation of the log-modulus", gt=0)

    def on(self, mesh: TetMesh) -> "MaternPenalty":
        return MaternPenalty(self, mesh)


class MaternPenalty(Quadratic):
    """The penalty of `Matern` on a mesh, which draws maps too."""

    def __init__(self, settings: Matern, mesh: TetMesh) -> None:
        kappa = 2.0 / settings.length_mm
        # tau^2 of Lindgren et al., eq. (4)
        scale = 1.0 / (8.0 * np.pi * kappa * settings.deviation**2)
        difference, faces = jumps(mesh), mesh.adjacency
        flux = difference.T @ sp.diags(faces.areas / faces.distances) @ difference
        self._operator = (kappa**2 * sp.diags(mesh.volumes) + flux).tocsc()
        self._root = np.sqrt(mesh.volumes / scale)
        precision = scale * self._operator @ sp.diags(1.0 / mesh.volumes) @ self._operator
        # The uniform field is an eigenvector of Q C^-1, so the average by volume is the minimum.
        level, volumes = settings.level(mesh), relative(mesh.volumes)
        super().__init__(0.5 * (precision + precision.T), level, volumes)

    def sample(self, rng: np.random.Generator) -> Field:
        """Draw a map, MPa, for example for `tactorch.inverse.monte_carlo`; needs a given mean."""
        if self._level is None:
            raise ConfigError("regularization.level_mpa is null: give a mean to draw maps around.")
        white = self._root * rng.standard_normal(len(self._root))
        return np.exp(self._level + splu(self._operator).solve(white))

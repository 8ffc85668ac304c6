"""A package of somebody else: a material, a prior and a sensor map for tactorch."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from tactorch.config import option
from tactorch.fem.materials import IsotropicMaterial, lame
from tactorch.inverse import Prior, Quadratic
from tactorch.sensor.calibration import SensorMap


@dataclass(frozen=True)
class Yeoh(IsotropicMaterial):
    c: float = option(0.1, "Coefficient of the quadratic term", ge=0)

    def strain_energy(self, i1, i2, j, log_j, poisson):
        lam, mu = lame(poisson)
        return 0.5 * mu * (i1 - 3) + self.c * (i1 - 3) ** 2 - mu * log_j + 0.5 * lam * log_j**2


@dataclass(frozen=True, kw_only=True)
class Ridge(Prior):
    level_mpa: float = option(0.2, "Expected modulus", unit="MPa", gt=0)

    def on(self, mesh):
        return Quadratic(sp.identity(mesh.n_tets, format="csr"), float(np.log(self.level_mpa)))


@dataclass(frozen=True)
class Affine(SensorMap):
    def create(self, seed):
        return AffineMap(self)


class AffineMap:
    def __init__(self, options):
        self.options, self.matrix = options, np.zeros((0, 2))

    def fit(self, features, slopes, seed):
        self.matrix = np.linalg.lstsq(features, slopes, rcond=None)[0]

    def __call__(self, features):
        return features @ self.matrix

    def arrays(self):
        return {"matrix": self.matrix}

    def restore(self, arrays):
        self.matrix = arrays["matrix"]

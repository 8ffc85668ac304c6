"""Samples of the posterior of shapes, in coordinates in which it is close to a normal distribution.

From afar, a ball of radius R and contrast c acts by its strength R^3 (c - 1) / (c + 3/2) (J. D.
Eshelby, "The determination of the elastic field of an ellipsoidal inclusion, and related problems",
Proc. R. Soc. A 241 (1957), 376-396, for nearly incompressible bodies), and the next term of its
field is larger by R^2. The data depend on the strength and on R^2 nearly linearly. The posterior of
the logarithms is skewed instead: a radius that is estimated too large seems more certain than one
that is estimated too small.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from tactorch.inverse.shapes.field import ShapeField

_LIMIT = 4.0  # of the parameters, in standard deviations of the prior
_MIN_ACCEPTED = 0.1  # fraction of the samples with a radius and a contrast


@dataclass(frozen=True, eq=False)
class ShapePosterior:
    """Normal approximation of the posterior of shapes.

    Attributes:
        field: The family of the shapes, with the prior of its parameters.
        z: Parameters at which the model is linearised, in standard deviations of the prior.
        step: Change from there to the most probable parameters of the linearised model.
        covariance: Covariance of the parameters.
    """

    field: ShapeField
    z: Float[np.ndarray, " size"]
    step: Float[np.ndarray, " size"]
    covariance: Float[np.ndarray, "size size"]

    def samples(self, count: int, seed: int = 0) -> Float[np.ndarray, "count size"]:
        """Return samples of the parameters, in standard deviations of the prior.

        The strengths and squared radii of inclusions and the other parameters are of a normal
        distribution, limited to positive radii and contrasts. Where it has hardly any such samples,
        the logarithms are of a normal distribution.
        """
        rng = np.random.default_rng(seed)
        values, deviation = self.field.physical(self.z), self.field.deviation
        point, jacobian = values.copy(), np.diag(deviation)
        for part in self.field.parts:
            radius, contrast = np.exp(values[part][3:5])
            rows = slice(part.start + 3, part.start + 5)
            strength = radius**3 * (contrast - 1.0) / (contrast + 1.5)
            by_contrast = radius**3 * 2.5 * contrast / (contrast + 1.5) ** 2
            by_logs = np.array([[2.0 * radius**2, 0.0], [3.0 * strength, by_contrast]])
            point[rows] = radius**2, strength
            jacobian[rows, rows] = by_logs * deviation[rows]
        mean, spread = point + jacobian @ self.step, jacobian @ self.covariance @ jacobian.T
        wide = max(count, int(2 * count / _MIN_ACCEPTED))
        draws = rng.multivariate_normal(mean, spread, size=wide, method="eigh")
        for part in self.field.parts:
            square, strength = draws[:, part.start + 3], draws[:, part.start + 4]
            with np.errstate(invalid="ignore", divide="ignore"):
                ratio = strength / np.maximum(square, 0.0) ** 1.5
                draws[:, part.start + 4] = np.log((1.0 + 1.5 * ratio) / (1.0 - ratio))
                draws[:, part.start + 3] = 0.5 * np.log(square)
        with np.errstate(invalid="ignore"):
            standard = self.field.standard(draws)
            limit = np.maximum(_LIMIT, np.abs(self.z) + 0.1)
            accepted = standard[(np.abs(standard) < limit).all(axis=1)]
        if len(accepted) < _MIN_ACCEPTED * wide:
            best = self.z + self.step
            return rng.multivariate_normal(best, self.covariance, size=count, method="eigh")
        return accepted[:count]

    def plain(self) -> dict[str, Any]:
        """Return plain JSON values; the inverse of `of`."""
        return {
            **self.field.plain(),
            "z": self.z.tolist(),
            "step": self.step.tolist(),
            "covariance": self.covariance.tolist(),
        }

    @staticmethod
    def of(plain: Mapping[str, Any]) -> "ShapePosterior":
        """Return the posterior from plain JSON values."""
        arrays = (np.array(plain[name]) for name in ("z", "step", "covariance"))
        return ShapePosterior(ShapeField.of(plain), *arrays)

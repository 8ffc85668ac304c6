"""The posterior of shapes, in coordinates in which it is close to a normal distribution."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from tactorch.inverse.shapes import strength
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
        rows = [slice(part.start + 3, part.start + 5) for part in self.field.parts]
        for row in rows:
            point[row] = strength.from_logs(values[row])
            jacobian[row, row] = strength.derivative(values[row]) * deviation[row]
        mean, spread = point + jacobian @ self.step, jacobian @ self.covariance @ jacobian.T
        wide = max(count, int(2 * count / _MIN_ACCEPTED))
        draws = rng.multivariate_normal(mean, spread, size=wide, method="eigh")
        for row in rows:
            draws[:, row] = strength.to_logs(draws[:, row])
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

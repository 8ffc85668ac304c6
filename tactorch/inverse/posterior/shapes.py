"""The posterior of shapes, normal in coordinates on which the data depend nearly linearly."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from tactorch.inverse.data.plain import to_plain
from tactorch.inverse.fields import CENTER, ShapeField, Vector, strength
from tactorch.inverse.posterior.ridges import Ridge

Draws = Float[np.ndarray, "k size"]
Matrix = Float[np.ndarray, "size size"]

_LIMIT = 4.0  # of the parameters, in standard deviations of the prior
_MIN_ACCEPTED = 0.1  # fraction of the samples with a radius and a contrast
_TRIALS = 20_000  # samples by which this fraction is estimated for a density, to 2 % at a tenth


class Normal(NamedTuple):
    """A normal distribution."""

    mean: Vector
    root: Matrix  # its product with its transpose is the covariance

    def standardised(self, x: Draws) -> Draws:
        """Return values as coordinates that are independent, of mean zero and deviation one."""
        return np.linalg.solve(self.root, (x - self.mean).T).T

    @property
    def log_volume(self) -> float:
        """Logarithm of the volume of a unit cube of the standardised coordinates."""
        return float(np.linalg.slogdet(self.root)[1])


@dataclass(frozen=True, eq=False)
class ShapePosterior:
    """Normal approximation of the posterior of shapes.

    The data depend nearly linearly on `coordinates`, in which the prior is flat beside the normal
    one. For normal noise this is close to Jeffreys' prior (H. Jeffreys, "An invariant form for the
    prior probability in estimation problems", Proc. R. Soc. A 186 (1946), 453-461). A prior that is
    flat in the logarithm of the contrast would give more weight to large contrasts, on which the
    data hardly depend.

    The coordinates are the squared radius and the strength of each inclusion, limited to positive
    radii and contrasts, and the other parameters in mm and logarithms. Where hardly any samples are
    within these limits, all parameters are. Where radius and contrast of an inclusion are
    uncertain, samples are about its ridge; see `tactorch.inverse.posterior.ridges`.

    Attributes:
        field: The family of the shapes, with the prior of its parameters.
        z: Parameters at which the model is linearised, in standard deviations of the prior.
        step: Change from there to the most probable parameters of the linearised model.
        covariance: Covariance of the parameters.
        ridges: Ridges of the inclusions whose radius and contrast are uncertain.
    """

    field: ShapeField
    z: Vector
    step: Vector
    covariance: Matrix
    ridges: tuple[Ridge, ...] = ()

    def samples(self, count: int, seed: int = 0) -> Draws:
        """Return samples of the parameters, in standard deviations of the prior."""
        rng = np.random.default_rng(seed)
        wide = max(count, int(2 * count / _MIN_ACCEPTED))
        accepted = (self._ridge_samples if self.ridges else self._linear_samples)(rng, wide)
        if len(accepted) < _MIN_ACCEPTED * wide:
            return self._log_samples(rng, count)
        return accepted[:count]

    @cached_property
    def is_linear(self) -> bool:
        """Whether squared radii and strengths are normal, rather than their logarithms."""
        return self._accepted >= _MIN_ACCEPTED

    @cached_property
    def normal(self) -> Normal:
        """The normal distribution of the coordinates."""
        point, jacobian = self._linearised(self.is_linear)
        return Normal(point + jacobian @ self.step, jacobian @ np.linalg.cholesky(self.covariance))

    def coordinates(self, z: Draws) -> Draws:
        """Return the normal coordinates of parameters: mm, mm^2, mm^3 and logarithms."""
        values = self.field.physical(z)
        for row in self._linear_rows:
            values[:, row] = strength.from_logs(values[:, row])
        return values

    def parameters(self, coordinates: Draws) -> Draws:
        """Return parameters, the inverse of `coordinates`; NaN where there are none."""
        values = coordinates.copy()
        for row in self._linear_rows:
            values[:, row] = strength.to_logs(values[:, row])
        return self.field.standard(values)

    def log_jacobian(self, z: Draws) -> Float[np.ndarray, " k"]:
        """Return the logarithm of the determinant of the coordinates' derivative by z."""
        values = self.field.physical(z)
        logs = np.full(len(z), np.log(self.field.deviation).sum())
        for row in self._linear_rows:
            logs += np.linalg.slogdet(strength.derivative(values[:, row]))[1]
        return logs

    def within_limits(self, z: Draws) -> Bool[np.ndarray, " k"]:
        """Return whether parameters exist and are within four deviations of the prior, or of z."""
        limit = np.maximum(_LIMIT, np.abs(self.z) + 0.1)
        return (np.abs(z) < limit).all(axis=1)

    @property
    def _linear_rows(self) -> list[Int[np.ndarray, "2"]]:
        return self.field.linear if self.is_linear else []

    def _linearised(self, linear: bool) -> tuple[Vector, Matrix]:
        """Return coordinates at z and their derivative, with strengths if linear."""
        values, deviation = self.field.physical(self.z), self.field.deviation
        point, jacobian = values.copy(), np.diag(deviation)
        for row in self.field.linear if linear else []:
            point[row] = strength.from_logs(values[row])
            jacobian[np.ix_(row, row)] = strength.derivative(values[row]) * deviation[row]
        return point, jacobian

    def _linear_samples(self, rng: np.random.Generator, count: int) -> Draws:
        """Return those of samples of normal strengths and squared radii that are within limits."""
        point, jacobian = self._linearised(True)
        mean, spread = point + jacobian @ self.step, jacobian @ self.covariance @ jacobian.T
        draws = rng.multivariate_normal(mean, spread, size=count, method="eigh")
        for row in self.field.linear:
            draws[:, row] = strength.to_logs(draws[:, row])
        with np.errstate(invalid="ignore"):
            standard = self.field.standard(draws)
            return standard[self.within_limits(standard)]

    def _ridge_samples(self, rng: np.random.Generator, count: int) -> Draws:
        """Return those of samples about the ridges that are within limits."""
        draws = self._log_samples(rng, count)
        for ridge in self.ridges:
            draws = ridge.transported(draws)
        return draws[self.within_limits(draws)]

    def _log_samples(self, rng: np.random.Generator, count: int) -> Draws:
        """Return samples whose logarithms are normal."""
        best = self.z + self.step
        return rng.multivariate_normal(best, self.covariance, size=count, method="eigh")

    @cached_property
    def _accepted(self) -> float:
        """Fraction of samples of normal strengths and squared radii that are within limits."""
        return len(self._linear_samples(np.random.default_rng(0), _TRIALS)) / _TRIALS

    def misplaced(self, deviation_mm: float) -> "ShapePosterior":
        """Return the posterior with an error of the places of inclusions, which data do not show.

        `deviation_mm` is its standard deviation along each axis.
        """
        covariance = self.covariance.copy()
        for k in range(len(self.field.families)):
            center = self.field.index(k, *CENTER)
            covariance[center, center] += (deviation_mm / self.field.deviation[center]) ** 2
        return replace(self, covariance=covariance)

    def plain(self) -> dict[str, Any]:
        """Return plain JSON values; the inverse of `of`."""
        names = ("z", "step", "covariance", "ridges")
        return self.field.plain() | to_plain({name: getattr(self, name) for name in names})

    @staticmethod
    def of(plain: Mapping[str, Any]) -> "ShapePosterior":
        """Return the posterior from plain JSON values."""
        z, step, covariance = (np.array(plain[name]) for name in ("z", "step", "covariance"))
        ridges = tuple(map(Ridge.of, plain.get("ridges", ())))
        return ShapePosterior(ShapeField.of(plain), z, step, covariance, ridges)

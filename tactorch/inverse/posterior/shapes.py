"""The posterior of shapes, normal in coordinates on which the data depend nearly linearly."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from tactorch.inverse.fields import ShapeField, strength
from tactorch.inverse.posterior.ridges import Ridge

_LIMIT = 4.0  # of the parameters, in standard deviations of the prior
_MIN_ACCEPTED = 0.1  # fraction of the samples with a radius and a contrast
_TRIALS = 20_000  # samples by which this fraction is estimated for a density, to 2 % at a tenth


class Normal(NamedTuple):
    """A normal distribution.

    Attributes:
        mean: Mean.
        root: A matrix whose product with its transpose is the covariance.
    """

    mean: Float[np.ndarray, " size"]
    root: Float[np.ndarray, "size size"]

    def standardised(self, x: Float[np.ndarray, "k size"]) -> Float[np.ndarray, "k size"]:
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

    The posterior is normal in `coordinates`: the squared radius and the strength of each inclusion,
    and the other parameters in mm and logarithms. Where hardly any of these coordinates are of a
    positive radius and contrast, all parameters are in mm and logarithms. Where radius and contrast
    of an inclusion are uncertain, the samples are those about its ridge, with Jeffreys' prior; see
    `tactorch.inverse.posterior.ridges`.

    Attributes:
        field: The family of the shapes, with the prior of its parameters.
        z: Parameters at which the model is linearised, in standard deviations of the prior.
        step: Change from there to the most probable parameters of the linearised model.
        covariance: Covariance of the parameters.
        ridges: Ridges of the inclusions whose radius and contrast are uncertain.
    """

    field: ShapeField
    z: Float[np.ndarray, " size"]
    step: Float[np.ndarray, " size"]
    covariance: Float[np.ndarray, "size size"]
    ridges: tuple[Ridge, ...] = ()

    def samples(self, count: int, seed: int = 0) -> Float[np.ndarray, "count size"]:
        """Return samples of the parameters, in standard deviations of the prior.

        The strengths and squared radii of inclusions and the other parameters are of a normal
        distribution, limited to positive radii and contrasts. Where it has hardly any such samples,
        the logarithms are of a normal distribution. With ridges, the samples are about these.
        """
        rng = np.random.default_rng(seed)
        wide = max(count, int(2 * count / _MIN_ACCEPTED))
        accepted = (self._ridge_samples if self.ridges else self._linear_samples)(rng, wide)
        if len(accepted) < _MIN_ACCEPTED * wide:
            best = self.z + self.step
            return rng.multivariate_normal(best, self.covariance, size=count, method="eigh")
        return accepted[:count]

    def log_density(self, z: Float[np.ndarray, "k size"]) -> Float[np.ndarray, " k"]:
        """Return the logarithm of the density of `samples` without ridges at parameters.

        It is minus infinity at parameters that samples do not have. The density integrates to one
        within the error, of two percent at most, of the estimated fraction of normal samples that
        are of a positive radius and contrast.
        """
        squares = (self.normal.standardised(self.coordinates(z)) ** 2).sum(axis=1)
        heights = -0.5 * squares - 0.5 * z.shape[1] * np.log(2.0 * np.pi) - self.normal.log_volume
        density = heights + self.log_jacobian(z)
        if not self.is_linear:
            return density
        return np.where(self.within_limits(z), density - np.log(self._accepted), -np.inf)

    @cached_property
    def is_linear(self) -> bool:
        """Whether squared radii and strengths are normal, rather than their logarithms."""
        return self._accepted >= _MIN_ACCEPTED

    @cached_property
    def normal(self) -> Normal:
        """The normal distribution of the coordinates."""
        point, jacobian = self._linearised(self.is_linear)
        return Normal(point + jacobian @ self.step, jacobian @ np.linalg.cholesky(self.covariance))

    def coordinates(self, z: Float[np.ndarray, "k size"]) -> Float[np.ndarray, "k size"]:
        """Return the normal coordinates of parameters: mm, mm^2, mm^3 and logarithms."""
        values = self.field.physical(z)
        for row in self._linear_rows:
            values[:, row] = strength.from_logs(values[:, row])
        return values

    def parameters(self, coordinates: Float[np.ndarray, "k size"]) -> Float[np.ndarray, "k size"]:
        """Return parameters, the inverse of `coordinates`; NaN where there are none."""
        values = coordinates.copy()
        for row in self._linear_rows:
            values[:, row] = strength.to_logs(values[:, row])
        return self.field.standard(values)

    def log_jacobian(self, z: Float[np.ndarray, "k size"]) -> Float[np.ndarray, " k"]:
        """Return the logarithm of the determinant of the coordinates' derivative by z."""
        values = self.field.physical(z)
        logs = np.full(len(z), np.log(self.field.deviation).sum())
        for row in self._linear_rows:
            logs += np.linalg.slogdet(strength.derivative(values[:, row]))[1]
        return logs

    def within_limits(self, z: Float[np.ndarray, "k size"]) -> Bool[np.ndarray, " k"]:
        """Return whether parameters exist and are within four deviations of the prior, or of z."""
        limit = np.maximum(_LIMIT, np.abs(self.z) + 0.1)
        return (np.abs(z) < limit).all(axis=1)

    @property
    def _linear_rows(self) -> list[Int[np.ndarray, "2"]]:
        return self.field.linear if self.is_linear else []

    def _linearised(
        self, linear: bool
    ) -> tuple[Float[np.ndarray, " size"], Float[np.ndarray, "size size"]]:
        """Return coordinates at z and their derivative, with strengths if linear."""
        values, deviation = self.field.physical(self.z), self.field.deviation
        point, jacobian = values.copy(), np.diag(deviation)
        for row in self.field.linear if linear else []:
            point[row] = strength.from_logs(values[row])
            jacobian[np.ix_(row, row)] = strength.derivative(values[row]) * deviation[row]
        return point, jacobian

    def _linear_samples(
        self, rng: np.random.Generator, count: int
    ) -> Float[np.ndarray, "accepted size"]:
        """Return those of samples of normal strengths and squared radii that are within limits."""
        point, jacobian = self._linearised(True)
        mean, spread = point + jacobian @ self.step, jacobian @ self.covariance @ jacobian.T
        draws = rng.multivariate_normal(mean, spread, size=count, method="eigh")
        for row in self.field.linear:
            draws[:, row] = strength.to_logs(draws[:, row])
        with np.errstate(invalid="ignore"):
            standard = self.field.standard(draws)
            return standard[self.within_limits(standard)]

    def _ridge_samples(
        self, rng: np.random.Generator, count: int
    ) -> Float[np.ndarray, "accepted size"]:
        """Return those of samples about the ridges that are within limits."""
        best = self.z + self.step
        draws = rng.multivariate_normal(best, self.covariance, size=count, method="eigh")
        for ridge in self.ridges:
            draws = ridge.transported(draws)
        return draws[self.within_limits(draws)]

    @cached_property
    def _accepted(self) -> float:
        """Fraction of samples of normal strengths and squared radii that are within limits."""
        return len(self._linear_samples(np.random.default_rng(0), _TRIALS)) / _TRIALS

    def plain(self) -> dict[str, Any]:
        """Return plain JSON values; the inverse of `of`."""
        return {
            **self.field.plain(),
            "z": self.z.tolist(),
            "step": self.step.tolist(),
            "covariance": self.covariance.tolist(),
            "ridges": [ridge.plain() for ridge in self.ridges],
        }

    @staticmethod
    def of(plain: Mapping[str, Any]) -> "ShapePosterior":
        """Return the posterior from plain JSON values."""
        z, step, covariance = (np.array(plain[name]) for name in ("z", "step", "covariance"))
        ridges = tuple(map(Ridge.of, plain.get("ridges", ())))
        return ShapePosterior(ShapeField.of(plain), z, step, covariance, ridges)

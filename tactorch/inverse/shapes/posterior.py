"""The posterior of shapes, normal in coordinates on which the data depend nearly linearly."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import logsumexp, softmax

from tactorch.inverse.shapes import strength
from tactorch.inverse.shapes.field import ShapeField

_WIDER = 2.0  # deviations of a proposal over those of the linearised model
_LIMIT = 4.0  # of the parameters, in standard deviations of the prior
_MIN_ACCEPTED = 0.1  # fraction of the samples with a radius and a contrast
_TRIALS = 20_000  # draws by which this fraction is estimated
_INTEGRAL_DRAWS = 200_000  # by which the integral of the density is estimated
_PER_SAMPLE = 20  # normal draws, of which one is chosen by the density


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

    def draws(self, count: int, rng: np.random.Generator) -> Float[np.ndarray, "count size"]:
        """Return samples."""
        return self.mean + rng.standard_normal((count, len(self.mean))) @ self.root.T

    def log_density(self, x: Float[np.ndarray, "k size"]) -> Float[np.ndarray, " k"]:
        """Return the logarithm of the density at values."""
        squares = (self.standardised(x) ** 2).sum(axis=1)
        return -0.5 * squares - 0.5 * len(self.mean) * np.log(2.0 * np.pi) - self.log_volume

    @property
    def log_volume(self) -> float:
        """Logarithm of the volume of a unit cube of the standardised coordinates."""
        return float(np.linalg.slogdet(self.root)[1])


@dataclass(frozen=True, eq=False)
class ShapePosterior:
    """Approximation of the posterior of shapes, by a linearised model and the exact prior.

    The model is linear in `coordinates`: the squared radius and the strength of each inclusion, and
    the other parameters in mm and logarithms. The prior is normal in mm and logarithms. Where
    hardly any of a normal distribution of the coordinates are of a positive radius and contrast,
    the model is linear in mm and logarithms as well.

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

        They are chosen by their densities among draws of normal distributions, of the coordinates
        and of the logarithms (sampling, importance resampling: D. B. Rubin, "Using the
        SIR algorithm to simulate posterior distributions", Bayesian Statistics 3 (1988), 395-402).
        """
        rng = np.random.default_rng(seed)
        if not self.is_linear:
            return self._logarithms.draws(count, rng)
        z, logs = self._weighted_draws(_PER_SAMPLE * count, rng)
        bounds = np.cumsum(softmax(logs))
        levels = (np.arange(count) + rng.random()) / count * bounds[-1]  # systematic resampling
        return rng.permutation(z[np.searchsorted(bounds, levels)])

    def log_density(self, z: Float[np.ndarray, "k size"]) -> Float[np.ndarray, " k"]:
        """Return the logarithm of the density of `samples` at parameters.

        It is minus infinity at parameters that samples do not have. The density integrates to one
        within the error, of a few percent at most, of an integral by random draws.
        """
        if not self.is_linear:
            return self._logarithms.log_density(z)
        return self._log_target(z) - self._log_integral

    @cached_property
    def is_linear(self) -> bool:
        """Whether the model is linear in squared radii and strengths, rather than logarithms."""
        rng, (point, jacobian) = np.random.default_rng(0), self._linearised(True)
        root = jacobian @ np.linalg.cholesky(self.covariance)
        draws = Normal(point + jacobian @ self.step, root).draws(_TRIALS, rng)
        return bool(self.within_limits(self._from_linear(draws)).mean() >= _MIN_ACCEPTED)

    @cached_property
    def normal(self) -> Normal:
        """The normal posterior of the coordinates with the linearised prior."""
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
    def _rows(self) -> list[slice]:
        """Logarithms of radius and contrast of each inclusion."""
        return [slice(part.start + 3, part.start + 5) for part in self.field.parts]

    @property
    def _linear_rows(self) -> list[slice]:
        return self._rows if self.is_linear else []

    def _linearised(
        self, linear: bool
    ) -> tuple[Float[np.ndarray, " size"], Float[np.ndarray, "size size"]]:
        """Return coordinates at z and their derivative, with strengths if linear."""
        values, deviation = self.field.physical(self.z), self.field.deviation
        point, jacobian = values.copy(), np.diag(deviation)
        for row in self._rows if linear else []:
            point[row] = strength.from_logs(values[row])
            jacobian[row, row] = strength.derivative(values[row]) * deviation[row]
        return point, jacobian

    def _from_linear(self, draws: Float[np.ndarray, "k size"]) -> Float[np.ndarray, "k size"]:
        """Return parameters from coordinates with strengths; NaN where there are none."""
        values = draws.copy()
        for row in self._rows:
            values[:, row] = strength.to_logs(values[:, row])
        return self.field.standard(values)

    @cached_property
    def _logarithms(self) -> Normal:
        """Normal distribution of the parameters where the model is linear in these."""
        return Normal(self.z + self.step, np.linalg.cholesky(self.covariance))

    @cached_property
    def _wide(self) -> Normal:
        """The same with larger deviations of radii and contrasts, whose tails are long."""
        factors = np.ones(len(self.z))
        for row in self._rows:
            factors[row] = _WIDER
        return Normal(self._logarithms.mean, factors[:, None] * self._logarithms.root)

    def _weighted_draws(
        self, count: int, rng: np.random.Generator
    ) -> tuple[Float[np.ndarray, "drawn size"], Float[np.ndarray, " drawn"]]:
        """Return draws of three normal distributions within limits, and logarithms of weights.

        The mean weight, with zero for the others of `count`, is the integral of the density.
        """
        proposals = self._logarithms, self._wide
        counts = [count - 2 * (count // 3), count // 3]
        parts = [p.draws(n, rng) for p, n in zip(proposals, counts, strict=True)]
        z = np.concatenate([*parts, self.parameters(self.normal.draws(count // 3, rng))])
        z = z[self.within_limits(z)]
        densities = [proposal.log_density(z) for proposal in proposals]
        densities.append(self.normal.log_density(self.coordinates(z)) + self.log_jacobian(z))
        return z, self._log_target(z) - logsumexp(densities, axis=0) + np.log(3.0)

    @cached_property
    def _log_integral(self) -> float:
        _, logs = self._weighted_draws(_INTEGRAL_DRAWS, np.random.default_rng(0))
        return float(logsumexp(logs) - np.log(_INTEGRAL_DRAWS))

    def _log_target(self, z: Float[np.ndarray, "k size"]) -> Float[np.ndarray, " k"]:
        """Return the logarithm of the density up to a constant: likelihood and exact prior.

        The normal posterior over its prior, that of z plus a linear step, is the likelihood.
        """
        standard = self.normal.standardised(self.coordinates(z))
        before = self.normal.standardised(self.coordinates(self.z[None]))
        linear = self.z + (standard - before) @ np.linalg.cholesky(self.covariance).T
        squares = (standard**2).sum(axis=1) - (linear**2).sum(axis=1) + (z**2).sum(axis=1)
        return np.where(self.within_limits(z), -0.5 * squares, -np.inf)

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

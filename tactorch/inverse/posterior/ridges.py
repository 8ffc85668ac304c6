"""The posterior of an inclusion along the ridge on which radius and contrast compensate each other.

Where the data hardly distinguish a small inclusion of large contrast from a larger one of a smaller
contrast, no coordinates make the posterior normal. Its ridge is followed from the best fit: the
parameters are fitted again at several values of t, a difference of log-radius and log-contrast in
standard deviations of their prior that changes along the ridge. Conditional on t the posterior is
normal (Laplace approximation), as in the profile likelihood (A. Raue et al., Bioinformatics 25
(2009), 1923-1929) and the nested approximation of H. Rue et al. (J. R. Stat. Soc. B 71 (2009),
319-392). With Jeffreys' prior, beside the normal one, the determinants cancel but for the deviation
of t, and the marginal density of t is that of the conditional optimum over this deviation. Central
intervals are then close to those of the profile likelihood.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator, make_interp_spline
from scipy.linalg import null_space, solve_triangular
from scipy.special import ndtr

from tactorch.inverse.data.plain import with_arrays

_GRID = 2001  # values of t of the distribution function
_TAIL = 1.0  # length of t beyond the last points, in standard deviations of the prior
_MIN_SLOPE = 0.5  # of the log-density beyond the last points


@dataclass(frozen=True, eq=False)
class RidgePoint:
    """The conditional posterior at one value of t."""

    z: Float[np.ndarray, " size"]  # most probable, in standard deviations of the prior
    height: float  # half the sum of squared residuals and squared parameters
    slope: float  # derivative of `height` by t along the ridge
    along: Float[np.ndarray, " size"]  # derivative of `z` by t along the ridge
    root: Float[np.ndarray, "others others"]  # of the conditional covariance, see `basis_across`
    deviation: float  # of t in the model linearised here

    @staticmethod
    def of(
        z: Float[np.ndarray, " size"],
        residuals: Float[np.ndarray, " data"],
        jacobian: Float[np.ndarray, "data size"],
        direction: Float[np.ndarray, " size"],
    ) -> "RidgePoint":
        """Return the point of the same t as parameters near it, with the residuals at these."""
        hessian, gradient = jacobian.T @ jacobian + np.eye(len(z)), jacobian.T @ residuals + z
        basis = basis_across(direction)
        across = basis.T @ hessian @ basis
        step = -basis @ np.linalg.solve(across, basis.T @ gradient)
        covariance = np.linalg.inv(hessian)
        variance = float(direction @ covariance @ direction)
        along = covariance @ direction / variance
        return RidgePoint(
            z + step,
            0.5 * float(residuals @ residuals + z @ z + step @ gradient),
            float(along @ (gradient + hessian @ step)),
            along,
            # Not the factor of the inverse, which round-off may make indefinite.
            solve_triangular(np.linalg.cholesky(across), np.eye(len(across)), lower=True).T,
            np.sqrt(variance),
        )

    def step(
        self, sign: float, rise: float, longest: float, bend: float | np.ndarray = 0.0
    ) -> Float[np.ndarray, " size"]:
        """Return the step along the ridge at whose end a parabola is higher by `rise`.

        No parameter changes by more than `longest` to first order; `bend` is the derivative of
        `along` by t.
        """
        slope, curvature = sign * self.slope, self.deviation**-2
        change = (np.sqrt(slope**2 + 2.0 * rise * curvature) - slope) / curvature
        change = sign * min(change, longest / float(np.abs(self.along).max()))
        return np.asarray(change * self.along + 0.5 * change**2 * bend)

    def bend(
        self, other: "RidgePoint", direction: Float[np.ndarray, " size"]
    ) -> Float[np.ndarray, " size"]:
        """Return the mean derivative of `along` by t between this point and another one."""
        return (self.along - other.along) / float((self.z - other.z) @ direction)


def basis_across(direction: Float[np.ndarray, " size"]) -> Float[np.ndarray, "size others"]:
    """Return an orthonormal basis of the parameters' changes at the same t, see `Ridge`."""
    return np.asarray(null_space(direction[None]))


@dataclass(frozen=True, eq=False)
class Ridge:
    """The posterior about the ridge of an inclusion."""

    inclusion: int  # its number
    direction: Float[np.ndarray, " size"]  # unit vector whose product with the parameters is t
    points: tuple[RidgePoint, ...]  # in ascending order of t
    start: int  # number of the point at which the normal posterior is linearised

    @staticmethod
    def through(
        start: RidgePoint,
        others: Sequence[RidgePoint],
        inclusion: int,
        direction: Float[np.ndarray, " size"],
    ) -> "Ridge":
        """Return the ridge through points, of which the normal posterior is at the first."""
        points = sorted((start, *others), key=lambda point: float(point.z @ direction))
        return Ridge(inclusion, direction, tuple(points), points.index(start))

    @cached_property
    def t(self) -> Float[np.ndarray, " points"]:
        """Value of t of each point."""
        return np.array([point.z @ self.direction for point in self.points])

    def transported(self, draws: Float[np.ndarray, "k size"]) -> Float[np.ndarray, "k size"]:
        """Return samples about the ridge from those of the normal posterior.

        Quantiles of t are kept, and so are the other parameters' deviations from their conditional
        means, in units of their conditional deviations.
        """
        start, basis = self.points[self.start], basis_across(self.direction)
        offset = (draws - start.z) @ self.direction
        t = self.quantiles(ndtr(offset / start.deviation + start.slope * start.deviation))
        rest = (draws - start.z - offset[:, None] * start.along) @ basis
        units = np.linalg.solve(start.root, rest.T).T
        # Factors of the conditional covariance are linear between the points.
        roots = self._between(partial(make_interp_spline, k=1), t, self._all("root"))
        spread = np.einsum("kij,kj->ki", roots, units) @ basis.T
        return self.mean(t) + spread

    def mean(self, t: Float[np.ndarray, " k"]) -> Float[np.ndarray, "k size"]:
        """Return the conditional mean of the parameters; it is straight beyond the last points."""
        mean = self._between(CubicHermiteSpline, t, self._all("z"), self._all("along"))
        ends = np.where((t < self.t[0])[:, None], self.points[0].along, self.points[-1].along)
        return np.asarray(mean + (t - self._inside(t))[:, None] * ends)

    def quantiles(self, levels: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
        """Return the quantiles of t at levels between 0 and 1."""
        grid = np.linspace(self.t[0] - _TAIL, self.t[-1] + _TAIL, _GRID)
        logs = self.log_density(grid)
        sums = np.cumsum(np.exp(logs - logs.max()))
        return np.interp(levels, (sums - 0.5 * np.diff(sums, prepend=0.0)) / sums[-1], grid)

    def log_density(self, t: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
        """Return the logarithm of the marginal density of t, up to a constant."""
        heights, slopes, deviations = map(self._all, ("height", "slope", "deviation"))
        height = self._between(CubicHermiteSpline, t, heights - heights.min(), slopes)
        log = self._between(PchipInterpolator, t, np.log(deviations))
        out = t - self._inside(t)
        below, above = min(slopes[0], -_MIN_SLOPE), max(slopes[-1], _MIN_SLOPE)
        curvature = np.where(out < 0, deviations[0], deviations[-1]) ** -2.0
        height = height + np.where(out < 0, below, above) * out + 0.5 * curvature * out**2
        return np.asarray(-height - log)

    def _all(self, name: str) -> np.ndarray:
        return np.array([getattr(point, name) for point in self.points])

    def _inside(self, t: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
        return np.clip(t, self.t[0], self.t[-1])

    def _between(
        self, spline: Callable[..., Any], t: Float[np.ndarray, " k"], *values: np.ndarray
    ) -> np.ndarray:
        """Return values between the points, those at the last ones beyond."""
        if len(self.points) == 1:
            return np.repeat(values[0], len(t), axis=0)
        return np.asarray(spline(self.t, *values)(self._inside(t)))

    @staticmethod
    def of(plain: Mapping[str, Any]) -> "Ridge":
        """Return the ridge from plain JSON values, as of `to_plain`."""
        values = with_arrays(dict(plain, points=()))
        points = tuple(RidgePoint(**with_arrays(point)) for point in plain["points"])
        return Ridge(**values | {"points": points})

"""Adaptive importance sampling of a posterior with few parameters, and its diagnostics.

Draws of a proposal q have the weights p / q, normalised to sum to one (self-normalised importance
sampling: A. B. Owen, Monte Carlo theory, methods and examples, 2013, chapter 9). The first
proposals are given. Later ones are multivariate Student t distributions, whose tails are heavier
than normal ones, with the mean and covariance of the weighted draws so far. Each draw is weighted
by the mixture of all proposals (J.-M. Cornuet, J.-M. Marin, A. Mira and C. P. Robert, "Adaptive
multiple importance sampling", Scand. J. Stat. 39 (2012), 798-812).

Two figures show whether the weights can be trusted: the effective sample size, and the shape k of
the generalised Pareto distribution of the largest weights, of which moments of an order above 1 / k
are infinite (A. Vehtari, D. Simpson, A. Gelman, Y. Yao and J. Gabry, "Pareto smoothed importance
sampling", J. Mach. Learn. Res. 25 (2024), 1-58).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import gammaln, logsumexp, softmax

from tactorch.errors import ConvergenceError
from tactorch.inverse.posterior.shapes import Draws, Normal

_DEGREES = 5.0  # of freedom of the proposals: tails that are heavier than normal ones
_FITTED = 2  # proposals that are fitted to the draws before, one after the other
_TRIALS, _MIN_POSSIBLE = 20_000, 0.01  # draws that show which fraction of them is possible
_PRIOR_DRAWS = 2.0  # for which a given covariance counts, over the number of parameters
_PRIOR_K, _PRIOR_TAIL = 0.5, 10.0  # prior mean of k, and the number of weights that it counts for
_MIN_TAIL = 5  # largest weights to which a Pareto distribution is fitted

Weights = Float[np.ndarray, " k"]  # or their logarithms, of each draw
LogDensity = Callable[[Float[np.ndarray, " size"]], float]


def importance_sample(
    first: Sequence["Student"], fitted: "Student", log_target: LogDensity, draws: int, seed: int = 0
) -> tuple[Draws, Weights]:
    """Return draws and the logarithms of their weights, whose sum is one.

    As many are of each of the first proposals and of two later ones. The covariance of `fitted`, a
    distribution like these, counts for a few draws. The target is known up to a constant, and its
    logarithm is minus infinity where its density is zero.

    Raises:
        ConvergenceError: the density is zero at all draws, or hardly any values are possible.
    """
    rng, proposals = np.random.default_rng(seed), list(first)
    x, logs = np.zeros((0, len(fitted.normal.mean))), np.zeros(0)
    counts = [len(part) for part in np.array_split(np.arange(draws), len(first) + _FITTED)]
    for k, count in enumerate(counts):
        if k >= len(first):
            proposals.append(fitted.to(x, logs - _mixture(proposals, counts[:k], x)))
        new = proposals[k].draw(count, rng)
        x = np.concatenate([x, new])
        logs = np.concatenate([logs, [log_target(one) for one in new]])
    log_weights = logs - _mixture(proposals, counts, x)
    total = logsumexp(log_weights)
    if not np.isfinite(total):
        raise ConvergenceError("The density of the posterior is zero at all draws.")
    return x, log_weights - total


@dataclass(frozen=True, eq=False)
class Student:
    """Multivariate Student t distribution of five degrees of freedom, of possible values only."""

    normal: Normal  # mean and covariance are the centre and the scale
    is_possible: Callable[[Draws], Bool[np.ndarray, " k"]]

    def draw(self, count: int, rng: np.random.Generator) -> Draws:
        """Return draws.

        Raises:
            ConvergenceError: hardly any values are possible.
        """
        if self.possible < _MIN_POSSIBLE:
            raise ConvergenceError("Hardly any values about an approximate posterior are possible.")
        found = np.zeros((0, len(self.normal.mean)))
        while len(found) < count:
            x = self._draw(max(count, 1), rng)
            found = np.concatenate([found, x[self.is_possible(x)]])
        return found[:count]

    def log_density(self, x: Draws) -> Weights:
        """Return the logarithm of the density of possible values.

        It integrates to one within the error of the estimate of `possible`.
        """
        size, squares = x.shape[1], (self.normal.standardised(x) ** 2).sum(axis=1)
        power = 0.5 * (_DEGREES + size)
        constant = gammaln(power) - gammaln(0.5 * _DEGREES) - 0.5 * size * np.log(np.pi * _DEGREES)
        constant -= self.normal.log_volume + np.log(self.possible)
        return constant - power * np.log1p(squares / _DEGREES)

    @cached_property
    def possible(self) -> float:
        """Fraction of possible values under the distribution of all, estimated by draws."""
        x = self._draw(_TRIALS, np.random.default_rng(0))
        return float(self.is_possible(x).mean())

    def to(self, x: Draws, log_weights: Weights) -> "Student":
        """Return the distribution with the mean and covariance of weighted draws.

        The fewer effective draws there are, the nearer is the covariance to the present one.
        """
        if not np.isfinite(log_weights).any():
            return self
        weights, effective = softmax(log_weights), effective_size(log_weights)
        mean, root = weights @ x, self.normal.root
        offsets = x - mean
        share = effective / (effective + _PRIOR_DRAWS * x.shape[1])
        covariance = share * (weights[:, None] * offsets).T @ offsets
        covariance += (1.0 - share) * root @ root.T
        other = Student(Normal(mean, np.linalg.cholesky(covariance)), self.is_possible)
        return other if other.possible > _MIN_POSSIBLE else self

    def _draw(self, count: int, rng: np.random.Generator) -> Draws:
        noise = rng.standard_normal((count, len(self.normal.mean)))
        noise *= np.sqrt(_DEGREES / rng.chisquare(_DEGREES, count))[:, None]
        return self.normal.mean + noise @ self.normal.root.T


def _mixture(proposals: Sequence[Student], counts: Sequence[int], x: Draws) -> Weights:
    """Return the logarithm of the density of all draws, so many from each proposal."""
    used = [(n, one) for n, one in zip(counts, proposals, strict=True) if n]
    each = [np.log(n / sum(counts)) + one.log_density(x) for n, one in used]
    return logsumexp(each, axis=0)


def effective_size(log_weights: Weights) -> float:
    """Return the effective sample size (sum w)^2 / sum w^2 (Owen, section 9.3)."""
    weights = softmax(log_weights)
    return float(1.0 / (weights @ weights))


def pareto_shape(log_weights: Weights) -> float:
    """Return the shape k of the generalised Pareto distribution of the largest weights.

    It is fitted to the min(draws / 5, 3 sqrt(draws)) largest weights less the next one, by the
    estimate of J. Zhang and M. A. Stephens, "A new and efficient estimation method for the
    generalized Pareto distribution", Technometrics 51 (2009), 316-325, with the prior of Vehtari et
    al. (2024). It is infinite where fewer than five weights exceed that one, and minus infinity
    where none does, because they are equal.
    """
    count = int(np.ceil(min(0.2 * len(log_weights), 3.0 * np.sqrt(len(log_weights)))))
    relative = np.exp(np.sort(log_weights) - log_weights.max())
    excess = relative[-count:] - relative[-count - 1]
    excess = excess[excess > 0.0]
    if not len(excess):
        return -np.inf
    if len(excess) < _MIN_TAIL:
        return np.inf
    k, weight = _zhang_stephens(excess), len(excess) / (len(excess) + _PRIOR_TAIL)
    return weight * k + (1.0 - weight) * _PRIOR_K


def _zhang_stephens(x: Float[np.ndarray, " tail"]) -> float:
    """Return the shape k of a generalised Pareto distribution from ascending values.

    It is that of the mean of b = -k / scale over its profile likelihood, at points of its prior.
    """
    n, points = len(x), 30 + int(np.sqrt(len(x)))
    quartile = x[int(0.25 * n + 0.5) - 1]
    b = 1.0 - np.sqrt(points / (np.arange(points) + 0.5))
    b = 1.0 / x[-1] + b / (3.0 * quartile)
    k = np.log1p(-b[:, None] * x).mean(axis=1)
    likelihood = n * (np.log(-b / k) - k - 1.0)
    mean = softmax(likelihood) @ b
    return float(np.log1p(-mean * x).mean())


def weighted_quantile(
    values: Weights, weights: Weights, levels: Sequence[float]
) -> Float[np.ndarray, " levels"]:
    """Return quantiles at levels between 0 and 1.

    The distribution function is linear between the values, at each of which it is the weight below
    plus half the value's own.
    """
    order = np.argsort(values, kind="stable")
    below = np.cumsum(weights[order]) - 0.5 * weights[order]
    return np.interp(np.asarray(levels) * weights.sum(), below, values[order])

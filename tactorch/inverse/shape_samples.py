"""Samples of the posterior of shapes, by importance sampling with exact predictions.

The posterior of the parameters z of shapes, in standard deviations of their prior, is
p(z) ~ exp(-(|r(z)|^2 / s + |z|^2) / 2) J(z), with the residuals r of the presses' equilibria, the
inflation s = max(1, chi2) of the variance of the noise, and a prior J beside the normal one.
`ShapePosterior`, in which r is linearised or quadratic along ridges, is the first proposal of
importance sampling, with an equilibrium of each press for each draw; see
`tactorch.inverse.posterior.importance`. With ridges J is Jeffreys' prior, the root of the
determinant of the linearised precision at z; without any it is that in which the coordinates of
`ShapePosterior` are flat.
"""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError, ConvergenceError
from tactorch.inverse.fields import ShapeField
from tactorch.inverse.fit.settings import Settings
from tactorch.inverse.fit.shapes import ShapesOnSites, fit_shapes
from tactorch.inverse.forward.problem import Evaluation, InverseProblem
from tactorch.inverse.posterior.importance import (
    LogDensity,
    Student,
    Weights,
    effective_size,
    importance_sample,
    pareto_shape,
    weighted_quantile,
)
from tactorch.inverse.posterior.shapes import Draws, Normal, ShapePosterior
from tactorch.inverse.result.shapes import InclusionValues, Interval, ShapeReconstruction
from tactorch.inverse.search.model import Model
from tactorch.inverse.search.problem import ShapeProblem, is_same_model
from tactorch.inverse.search.sizing import refined_at_contacts
from tactorch.progress import progress_line
from tactorch.recording import Recording

_log = logging.getLogger(__name__)
_MIN_EFFECTIVE = 20.0  # draws, for a central 90 % interval
_MAX_K = 0.7  # with many draws
_MOMENT_SAMPLES = 5_000  # of the approximate posterior, of which the moments are


class ShapeIntervals(NamedTuple):
    """Central 90 % intervals of an inclusion.

    Attributes:
        center_90_mm: Intervals of the centre along x, y and z, mm.
        radius_90_mm: Interval of the radius of the ball of the same volume, mm.
        youngs_90_mpa: Interval of Young's modulus, MPa.
        contrast_90: Interval of Young's modulus over that of the background.
    """

    center_90_mm: tuple[Interval, Interval, Interval]
    radius_90_mm: Interval
    youngs_90_mpa: Interval
    contrast_90: Interval


@dataclass(frozen=True, eq=False)
class ShapeSamples:
    """Weighted draws of the posterior of shapes.

    Attributes:
        field: The family of the shapes, with the prior of its parameters.
        z: Parameters of each draw, in standard deviations of the prior.
        log_weights: Logarithms of the weights, whose sum is one; minus infinity where a press has
            no equilibrium.
        order: Numbers of the result's `inclusions` among those of the field.
    """

    field: ShapeField
    z: Float[np.ndarray, "draws size"]
    log_weights: Float[np.ndarray, " draws"]
    order: tuple[int, ...]

    @property
    def failed(self) -> int:
        """Number of draws in which a press has no equilibrium."""
        return int(np.isneginf(self.log_weights).sum())

    @cached_property
    def weights(self) -> Float[np.ndarray, " draws"]:
        """Weights of the draws, whose sum is one."""
        return np.exp(self.log_weights)

    @property
    def effective_size(self) -> float:
        """Effective sample size 1 / sum w^2: of as many equal weights."""
        return effective_size(self.log_weights)

    @cached_property
    def k_hat(self) -> float:
        """Pareto shape of the largest weights, see `tactorch.inverse.posterior.importance`."""
        return pareto_shape(self.log_weights)

    @property
    def reliable(self) -> bool:
        """Whether the effective sample size is 20 or more, and k below its limit.

        The limit is min(1 - 1 / log10(draws), 0.7), above which means converge too slowly (Vehtari
        et al., 2024).
        """
        limit = min(1.0 - 1.0 / np.log10(max(len(self.weights), 10)), _MAX_K)
        return bool(self.effective_size >= _MIN_EFFECTIVE and self.k_hat < limit)

    def quantile(self, values: Float[np.ndarray, " draws"], levels: Sequence[float]) -> np.ndarray:
        """Return the weighted quantiles of a value of each draw, at levels between 0 and 1."""
        return weighted_quantile(values, self.weights, levels)

    def inclusion(self, number: int) -> InclusionValues:
        """Return one of the inclusions in each draw, numbered as `inclusions` of the result."""
        return InclusionValues.of(self.field, self.z, self.order[number])

    def intervals(self) -> list[ShapeIntervals]:
        """Return central 90 % intervals of each inclusion, in the order of those of the result."""

        def interval(of: Float[np.ndarray, " draws"]) -> Interval:
            return Interval(*self.quantile(of, (0.05, 0.95)).tolist())

        found = []
        for values in map(self.inclusion, range(len(self.order))):
            x, y, z = map(interval, values.center_mm.T)
            others = (values.radius_mm, values.youngs_mpa, values.contrast)
            found.append(ShapeIntervals((x, y, z), *map(interval, others)))
        return found


def sample_shapes(
    recording: Recording,
    result: ShapeReconstruction,
    settings: Settings | None = None,
    *,
    draws: int = 200,
    seed: int = 0,
    show_progress: bool | None = None,
) -> ShapeSamples:
    """Return weighted draws of the posterior of shapes, with the exact predictions of each.

    Balls may be ellipsoids, as in `result.posterior`. Deviations of forces and poses are those of
    the result, at whose shapes predictions are corrected for the discretisation. A warning is
    logged where the weights are not reliable, see `ShapeSamples.reliable`.

    Args:
        recording: The presses.
        result: Their shapes, of `find_shapes`.
        settings: The settings of `find_shapes`.
        draws: Number of draws.
        seed: Seed of the draws.
        show_progress: Whether to show a line of progress; see `tactorch.progress.progress_line`.

    Raises:
        ConfigError: a setting cannot be used, there are fewer than two draws, or the shapes are
            fitted through the gel of a sensor.
        ConvergenceError: a press has no equilibrium at the result, on the mesh or on the finer
            ones of the correction, or no draw has one.
    """
    if draws < 2:
        raise ConfigError(f"draws={draws} must be 2 or more.")
    if result.through_gel:
        raise ConfigError(
            "The search was through the gel of a sensor, and draws are by its forces; use "
            "the intervals of the result."
        )
    with progress_line("draws of the posterior", show_progress) as update:
        exact = _ExactPosterior.of(recording, result, settings or Settings(), update)
        draw = sample_posterior(result.posterior, exact.log_density, draws, seed)
    samples = ShapeSamples(result.posterior.field, *draw, result.order)
    if not samples.reliable:
        _log.warning(
            "The samples of the posterior of shapes are not reliable: an effective sample size of "
            "%.3g of %d, k %.2g. Use more draws.",
            samples.effective_size,
            draws,
            samples.k_hat,
        )
    return samples


def sample_posterior(
    approximation: ShapePosterior, log_target: LogDensity, draws: int, seed: int = 0
) -> tuple[Draws, Weights]:
    """Return draws of parameters of shapes, and the logarithms of their weights.

    The first proposals are Student t distributions about the normal posterior in its coordinates,
    which has the shape of the posterior near its maximum, and in the logarithms with the moments of
    its samples, which reaches inclusions of large contrast. See `importance_sample` for the target.

    Raises:
        ConvergenceError: the density is zero at all draws, or hardly any have a radius and a
            contrast.
    """
    z = approximation.samples(_MOMENT_SAMPLES)
    normal = Normal(z.mean(axis=0), np.linalg.cholesky(np.atleast_2d(np.cov(z.T))))
    wide = Student(normal, approximation.within_limits)
    first = [_InCoordinates.of(approximation), wide]
    return importance_sample(first, wide, log_target, draws, seed)


@dataclass(frozen=True, eq=False)
class _InCoordinates(Student):
    """Student t distribution about a posterior in its coordinates, within its limits."""

    posterior: ShapePosterior

    @staticmethod
    def of(posterior: ShapePosterior) -> "_InCoordinates":
        return _InCoordinates(
            posterior.normal, lambda x: posterior.within_limits(posterior.parameters(x)), posterior
        )

    def draw(self, count: int, rng: np.random.Generator) -> Draws:
        return self.posterior.parameters(super().draw(count, rng))

    def log_density(self, x: Draws) -> Weights:
        coordinates = self.posterior.coordinates(x)
        return super().log_density(coordinates) + self.posterior.log_jacobian(x)


@dataclass(frozen=True, eq=False)
class _ExactPosterior:
    """The posterior of shapes at presses, as a function of their parameters."""

    problem: InverseProblem  # with the data, errors and corrections of the result
    family: ShapesOnSites  # all may be ellipsoids
    approximation: ShapePosterior
    evaluation: Evaluation  # where the approximation is linearised
    fields: Sequence[Float[np.ndarray, "size nodes 3"]]  # derivatives of each press, mm
    inflation: float  # variance of the noise over the stated one
    update: Callable[[str], None]  # called with the state as text at each evaluation

    @staticmethod
    def of(
        recording: Recording,
        result: ShapeReconstruction,
        settings: Settings,
        update: Callable[[str], None] = lambda state: None,
    ) -> "_ExactPosterior":
        """Return the posterior with the data, errors and corrections of a result."""
        if not is_same_model(recording):
            recording = refined_at_contacts(recording)
        problem = ShapeProblem(recording, settings)
        approximation = result.posterior
        evaluation = _predict(problem, result)
        family = ShapesOnSites(approximation.field, problem.sites)
        _, fields = evaluation.linear_response(family.at(approximation.z).changes)
        full = problem.full.with_data(evaluation.data)
        full.evaluations = 0
        inflation = max(1.0, result.chi2)
        return _ExactPosterior(full, family, approximation, evaluation, fields, inflation, update)

    def log_density(self, z: Float[np.ndarray, " size"]) -> float:
        """Return the logarithm of the density, up to a constant.

        It is minus infinity where a press has no equilibrium.
        """
        try:
            evaluation = self.problem.evaluate(self.family.at(z).youngs, starts=self._starts(z))
        except ConvergenceError as error:
            _log.debug("no equilibrium at a draw: %s", error)
            return -np.inf
        self.update(f"evaluation {self.problem.evaluations}")
        residuals = evaluation.residuals
        misfit = 0.5 * float(residuals @ residuals) / self.inflation
        return self._log_prior(z, evaluation) - misfit - self.family.shapes.penalty(z)

    def _log_prior(self, z: Float[np.ndarray, " size"], evaluation: Evaluation) -> float:
        """Return the logarithm of the prior beside the normal one, up to a constant."""
        if not self.approximation.ridges:
            return float(self.approximation.log_jacobian(z[None])[0])
        jacobian = self.family.at(z).jacobian(evaluation)
        precision = jacobian.T @ jacobian / self.inflation + np.eye(len(z))
        return 0.5 * float(np.linalg.slogdet(precision)[1])

    def _starts(self, z: Float[np.ndarray, " size"]) -> list[Float[np.ndarray, "nodes 3"]]:
        """Return the linearised displacements, on which few steps of an equilibrium search remain.

        They are linear in the coordinates of the normal posterior.
        """
        normal, pair = self.approximation.normal, np.array([self.approximation.z, z])
        before, after = normal.standardised(self.approximation.coordinates(pair))
        change = np.linalg.cholesky(self.approximation.covariance) @ (after - before)
        return self.evaluation.moved([np.tensordot(change, fields, 1) for fields in self.fields])


def _predict(problem: ShapeProblem, result: ShapeReconstruction) -> Evaluation:
    """Return the predictions at a result with its errors of the data, which are corrected."""
    errors = problem.errors.at_least(result.errors)
    full = problem.full.with_data(problem.data(errors))
    field, z = result.posterior.field, result.posterior.z
    model = Model(*fit_shapes(full, field, z, sites=problem.sites, max_iterations=0), errors)
    if is_same_model(problem.full.recording):
        return model.evaluation
    corrected = problem.corrected(model, np.inf)  # the parameters remain
    if corrected is model:
        raise ConvergenceError("The error of the discretisation cannot be computed; see the log.")
    return corrected.evaluation

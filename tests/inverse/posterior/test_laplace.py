from collections.abc import Callable

import numpy as np
import pytest
import scipy.sparse as sp

from tactorch.errors import ConfigError
from tactorch.inverse import (
    PRIORS,
    InverseProblem,
    Log,
    NuisancePrior,
    Objective,
)
from tactorch.inverse.fields import ElementField
from tactorch.inverse.posterior import LaplacePosterior
from tactorch.inverse.posterior.laplace import check_weight
from tactorch.metrics.coverage import calibration_error, coverage

M = 12
LOG = Log()


@pytest.fixture
def model() -> tuple[np.ndarray, np.ndarray]:
    """Jacobian of fewer data than unknowns, and a positive definite prior precision."""
    rng = np.random.default_rng(5)
    root = rng.normal(size=(M, M))
    return rng.normal(size=(7, M)), root @ root.T + np.eye(M)


def posterior(
    model: tuple[np.ndarray, np.ndarray], mean: np.ndarray | None = None
) -> LaplacePosterior:
    jacobian, prior = model
    mean = np.zeros(M) if mean is None else mean
    return LaplacePosterior.of(mean, jacobian, 2.0 * sp.csr_matrix(prior), LOG)


def test_equals_the_analytic_posterior(model: tuple[np.ndarray, np.ndarray]) -> None:
    jacobian, prior = model
    found = posterior(model)
    precision = jacobian.T @ jacobian + 2.0 * prior
    expected = np.linalg.inv(precision)
    some = np.array([3, 0, 7])
    np.testing.assert_allclose(found.variance(), expected.diagonal())
    np.testing.assert_allclose(found.covariance(some), expected[np.ix_(some, some)])
    resolution = (expected @ jacobian.T @ jacobian).diagonal()
    np.testing.assert_allclose(found.resolution_diagonal(), resolution, rtol=1e-10)
    drawn = found.sample(np.random.default_rng(1), 40_000)
    np.testing.assert_allclose(np.cov(drawn.T), expected, atol=0.03 * expected.max())


def test_interval_of_log_moduli_is_in_mpa_within_bounds(
    model: tuple[np.ndarray, np.ndarray],
) -> None:
    mean = np.full(M, np.log(0.2))
    mean[0] = np.log(99.9)
    found = posterior(model, mean)
    low, high = found.interval(0.95)
    np.testing.assert_allclose(low, np.exp(mean - 1.959964 * found.deviation()), rtol=1e-6)
    np.testing.assert_allclose(high[0], 100.0)
    with pytest.raises(ConfigError, match="level"):
        found.interval(95.0)


def test_truths_of_the_prior_are_covered_as_claimed(model: tuple[np.ndarray, np.ndarray]) -> None:
    jacobian, prior = model
    rng = np.random.default_rng(8)
    root = np.linalg.cholesky(np.linalg.inv(2.0 * prior))
    covariance = np.linalg.inv(jacobian.T @ jacobian + 2.0 * prior)
    deviation = posterior(model).deviation()  # the same whatever the data
    judged = []
    for _ in range(400):
        truth = root @ rng.normal(size=M)
        data = jacobian @ truth + rng.normal(size=7)
        mean = covariance @ (jacobian.T @ data)
        judged.append((truth, mean, deviation))
    assert coverage(judged, 0.9).fraction == pytest.approx(0.9, abs=0.02)
    assert calibration_error(judged) < 0.02
    bold = [(t, m, 0.5 * d) for t, m, d in judged]
    assert calibration_error(bold) > 0.1


def test_global_unknowns_widen_the_elements(model: tuple[np.ndarray, np.ndarray]) -> None:
    jacobian, prior = model
    wide = np.hstack([jacobian, np.ones((7, 1))])
    found = LaplacePosterior.of(np.zeros(M), wide, 2.0 * sp.csr_matrix(prior), LOG)
    assert found.variance().shape == found.resolution_diagonal().shape == (M,)
    assert found.sample(np.random.default_rng(0), 3).shape == (3, M)
    assert np.all(found.variance() >= posterior(model).variance())


def test_at_a_point_of_the_objective(
    make_problem: Callable[..., InverseProblem], moduli: np.ndarray
) -> None:
    problem = make_problem()
    prior = PRIORS.build("total_variation").on(problem.recording.mesh)
    point = Objective(problem, ElementField(LOG, prior, problem.n_elements)).at(np.log(moduli))
    found = LaplacePosterior.at(point, 3.0)
    precision = point.jacobian.T @ point.jacobian + 3.0 * point.penalty_curvature.toarray()
    np.testing.assert_allclose(found.variance(), np.linalg.inv(precision).diagonal(), rtol=1e-4)


def test_global_unknowns_count_with_their_own_prior(
    make_problem: Callable[..., InverseProblem], moduli: np.ndarray
) -> None:
    problem = make_problem()
    prior = PRIORS.build("total_variation").on(problem.recording.mesh)
    objective = Objective(
        problem, ElementField(LOG, prior, problem.n_elements), NuisancePrior(force_scale=0.2)
    )
    point = objective.at(objective.start(moduli))
    found = LaplacePosterior.at(point, 3.0)
    precision = point.jacobian.T @ point.jacobian + 3.0 * point.penalty_curvature.toarray()
    precision[-1, -1] += 1.0
    expected = np.linalg.inv(precision).diagonal()[:-1]
    np.testing.assert_allclose(found.variance(), expected, rtol=1e-4)


def test_undetermined_moduli_are_refused(model: tuple[np.ndarray, np.ndarray]) -> None:
    empty = sp.csr_matrix((M, M))
    with pytest.raises(ConfigError, match="undetermined"):
        LaplacePosterior.of(np.zeros(M), np.zeros((7, M)), empty, LOG)
    with pytest.raises(ConfigError, match="weight=-1"):
        check_weight(-1.0)

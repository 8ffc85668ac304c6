"""Importance sampling of known distributions: draws, weights, adaptation and diagnostics."""

import numpy as np
import pytest
from scipy.stats import f, genpareto, kstest, multivariate_t, norm

from tactorch.errors import ConvergenceError
from tactorch.inverse.posterior.importance import (
    Student,
    effective_size,
    importance_sample,
    pareto_shape,
    weighted_quantile,
)
from tactorch.inverse.posterior.shapes import Normal

SIZE = 6
ROOT = np.tril(0.3 * np.random.default_rng(0).standard_normal((SIZE, SIZE))) + np.eye(SIZE)
FIRST = Normal(np.arange(1.0, SIZE + 1.0), ROOT)


def everything(x):
    return np.ones(len(x), dtype=bool)


def above_the_mean(x):
    return x[:, 0] > FIRST.mean[0]


def normal_target(shift: float, scale: float):
    """Return the log-density of a normal distribution beside the first one, and of its width."""

    def log_density(x):
        standard = (FIRST.standardised(x[None])[0] - shift * np.eye(SIZE)[1]) / scale
        return -0.5 * float(standard @ standard)

    return log_density


def sample(log_target, is_possible, draws):
    first = Student(FIRST, is_possible)
    return importance_sample([first], first, log_target, draws)


def moments(x, log_weights):
    """Return mean and deviation of the standardised coordinates."""
    standard, weights = FIRST.standardised(x), np.exp(log_weights)
    mean = weights @ standard
    return mean, np.sqrt(weights @ (standard - mean) ** 2)


def test_draws_have_the_density():
    half = Student(FIRST, above_the_mean)
    assert half.possible == pytest.approx(0.5, abs=0.02)
    x = half.draw(4_000, np.random.default_rng(1))
    assert x.shape == (4_000, SIZE)
    assert above_the_mean(x).all()
    squares = (FIRST.standardised(x) ** 2).sum(axis=1) / SIZE
    assert kstest(squares, f(SIZE, 5.0).cdf).pvalue > 0.01
    expected = multivariate_t(FIRST.mean, ROOT @ ROOT.T, df=5.0).logpdf(x)
    np.testing.assert_allclose(half.log_density(x), expected - np.log(half.possible), atol=1e-9)


@pytest.mark.parametrize(("shift", "scale"), [(0.0, 1.0), (1.5, 0.6), (0.0, 1.5), (2.5, 1.0)])
def test_moments_are_those_of_the_target(shift, scale):
    x, logs = sample(normal_target(shift, scale), everything, 1_500)
    assert np.exp(logs).sum() == pytest.approx(1.0)
    assert effective_size(logs) > 300.0
    mean, deviation = moments(x, logs)
    tolerance = 4.0 * scale / np.sqrt(effective_size(logs))
    np.testing.assert_allclose(mean, shift * np.eye(SIZE)[1], atol=tolerance)
    np.testing.assert_allclose(deviation, scale, atol=tolerance)


def test_later_proposals_are_nearer_to_the_target():
    target = normal_target(2.5, 0.6)
    x, logs = sample(target, everything, 420)
    assert effective_size(logs) > 80.0
    rounds = np.split(x, 3)
    means = [FIRST.standardised(part)[:, 1].mean() for part in rounds]
    assert means[0] == pytest.approx(0.0, abs=0.5)
    assert means[2] == pytest.approx(2.5, abs=0.5)
    first = np.array([target(one) for one in rounds[0]])
    first -= Student(FIRST, everything).log_density(rounds[0])
    assert 3.0 * effective_size(first) < 0.5 * effective_size(logs)


def test_impossible_values_are_left_out():
    """Half of a normal distribution: the mean is sqrt(2 / pi) deviations from the middle."""
    calls = []

    def log_density(x):
        calls.append(x)
        return normal_target(0.0, 1.0)(x)

    x, logs = sample(log_density, above_the_mean, 2_000)
    assert len(calls) == 2_000
    assert above_the_mean(x).all()
    mean = np.exp(logs) @ (x[:, 0] - FIRST.mean[0]) / ROOT[0, 0]
    assert mean == pytest.approx(np.sqrt(2.0 / np.pi), abs=0.06)


def test_values_of_zero_density_have_no_weight():
    def log_density(x):
        return normal_target(0.0, 1.0)(x) if x[0] > FIRST.mean[0] else -np.inf

    x, logs = sample(log_density, everything, 2_000)
    zero = np.isneginf(logs)
    np.testing.assert_array_equal(zero, ~above_the_mean(x))
    assert 100 < zero.sum() < 1_900
    mean = np.exp(logs) @ (x[:, 0] - FIRST.mean[0]) / ROOT[0, 0]
    assert mean == pytest.approx(np.sqrt(2.0 / np.pi), abs=0.06)


@pytest.mark.parametrize("draws", [1, 2, 3, 7])
def test_a_few_draws_suffice(draws):
    x, logs = sample(normal_target(0.0, 1.0), everything, draws)
    assert x.shape == (draws, SIZE)
    assert np.exp(logs).sum() == pytest.approx(1.0)


def test_failures_are_said():
    with pytest.raises(ConvergenceError, match="zero at all draws"):
        sample(lambda x: -np.inf, everything, 8)
    with pytest.raises(ConvergenceError, match="Hardly any"):
        sample(normal_target(0.0, 1.0), lambda x: x[:, 0] > 100.0, 8)


@pytest.mark.parametrize("k", [0.2, 0.6, 1.2])
def test_the_pareto_shape_of_weights_is_found(k):
    weights = genpareto(k).rvs(40_000, random_state=np.random.default_rng(1))
    # 600 weights: the error is (1 + k) / sqrt(600).
    assert pareto_shape(np.log(weights) - 1000.0) == pytest.approx(k, abs=0.2)


def test_the_pareto_shape_of_bounded_and_degenerate_weights():
    rng = np.random.default_rng(0)
    assert pareto_shape(np.log(rng.random(40_000))) == pytest.approx(-1.0, abs=0.2)
    assert pareto_shape(np.zeros(100)) == -np.inf
    assert pareto_shape(np.r_[np.full(99, -np.inf), 0.0]) == np.inf
    # Small tails are drawn towards one half.
    assert abs(pareto_shape(np.log(rng.random(30))) - 0.5) < 1.0


def test_the_effective_size_is_that_of_equal_weights():
    assert effective_size(np.full(50, -3.0)) == pytest.approx(50.0)
    half = np.r_[np.full(25, 2.0), np.full(25, -np.inf)]
    assert effective_size(half) == pytest.approx(25.0)


def test_weighted_quantiles():
    rng, levels = np.random.default_rng(0), [0.05, 0.5, 0.95]
    values = rng.standard_normal(20_000)
    equal = weighted_quantile(values, np.full(len(values), 1e-4), levels)
    np.testing.assert_allclose(equal, np.quantile(values, levels, method="hazen"), atol=1e-12)
    weights = norm(0.5, 0.8).pdf(values) / norm.pdf(values)
    shifted = weighted_quantile(values, weights, levels)
    np.testing.assert_allclose(shifted, norm(0.5, 0.8).ppf(levels), atol=0.03)

import numpy as np
import pytest

from tactorch.errors import ConfigError
from tactorch.inverse.posterior.gaussian_state import GaussianState


@pytest.fixture
def belief() -> GaussianState:
    rng = np.random.default_rng(0)
    root = rng.standard_normal((6, 6))
    return GaussianState(rng.standard_normal(6), root @ root.T + np.eye(6))


def test_a_map_updates_as_eq_16_and_17(belief: GaussianState) -> None:
    rng = np.random.default_rng(1)
    observed, credibility = rng.standard_normal(6), rng.uniform(0.1, 5.0, 6)
    rows = np.diag(np.sqrt(credibility))
    found = belief.after_press(rows, rows @ (observed - belief.mean))
    before = np.linalg.inv(belief.covariance)
    precision = before + np.diag(credibility)
    mean = np.linalg.solve(precision, before @ belief.mean + credibility * observed)
    np.testing.assert_allclose(found.covariance, np.linalg.inv(precision), atol=1e-10)
    np.testing.assert_allclose(found.mean, mean, atol=1e-10)


def test_no_credibility_changes_nothing(belief: GaussianState) -> None:
    found = belief.after_press(np.zeros((6, 6)), np.zeros(6))
    np.testing.assert_array_equal(found.mean, belief.mean)
    np.testing.assert_array_equal(found.covariance, belief.covariance)


def test_two_presses_are_as_good_as_both_at_once(belief: GaussianState) -> None:
    rng = np.random.default_rng(2)
    jacobian, truth = rng.standard_normal((5, 6)), rng.standard_normal(6)
    at_once = belief.after_press(jacobian, jacobian @ (truth - belief.mean))
    step = belief.after_press(jacobian[:2], jacobian[:2] @ (truth - belief.mean))
    step = step.after_press(jacobian[2:], jacobian[2:] @ (truth - step.mean))
    np.testing.assert_allclose(step.mean, at_once.mean, atol=1e-9)
    np.testing.assert_allclose(step.covariance, at_once.covariance, atol=1e-9)


def test_gain_is_half_the_fall_of_log_det(belief: GaussianState) -> None:
    jacobian = np.random.default_rng(3).standard_normal((4, 6))
    after = belief.after_press(jacobian, np.zeros(4))
    fall = np.linalg.slogdet(belief.covariance)[1] - np.linalg.slogdet(after.covariance)[1]
    assert belief.information_gain(jacobian) == pytest.approx(fall / 2, rel=1e-9)


def test_variance_falls_as_foretold(belief: GaussianState) -> None:
    jacobian = np.random.default_rng(4).standard_normal((4, 6))
    after = belief.after_press(jacobian, np.ones(4))
    fall = belief.covariance.diagonal() - after.covariance.diagonal()
    np.testing.assert_allclose(belief.expected_variance_reduction(jacobian), fall, rtol=1e-9)
    with pytest.raises(ConfigError, match="5 columns"):
        belief.expected_variance_reduction(np.ones((2, 5)))


def test_wrong_shapes_are_refused(belief: GaussianState) -> None:
    with pytest.raises(ConfigError, match="5 columns"):
        belief.information_gain(np.ones((2, 5)))

"""Whitening of errors that data have in common, against dense linear algebra."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st

from tactorch.inverse import InverseProblem
from tactorch.inverse.data.observations import CorrelatedNoise
from tactorch.recording import Recording


@given(seed=st.integers(0, 2**32 - 1), k=st.integers(1, 5))
@settings(max_examples=25, deadline=None)
def test_whitened_covariance_is_one(seed: int, k: int) -> None:
    patterns = 3.0 * np.random.default_rng(seed).standard_normal((12, k))
    common = CorrelatedNoise(patterns)
    root = common.whiten(np.eye(12))
    np.testing.assert_allclose(root, root.T, atol=1e-12)
    covariance = np.eye(12) + patterns @ patterns.T
    np.testing.assert_allclose(root @ covariance @ root.T, np.eye(12), atol=1e-9)


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_patterns_of_each_press_remain_sparse(seed: int) -> None:
    rng = np.random.default_rng(seed)
    blocks = [np.linalg.qr(rng.standard_normal((6, 3)))[0] * [5.0, 2.0, 0.1] for _ in range(2)]
    each, shared = sp.block_diag(blocks, format="csr"), rng.standard_normal((12, 2))
    noise = CorrelatedNoise(shared, CorrelatedNoise(each))
    root, dense = noise.whiten(np.eye(12)), np.hstack([each.toarray(), shared])
    covariance = np.eye(12) + dense @ dense.T
    np.testing.assert_allclose(root @ covariance @ root.T, np.eye(12), atol=1e-9)
    np.testing.assert_allclose(noise.transposed(np.eye(12)), root.T, atol=1e-12)
    assert noise.log_determinant == pytest.approx(np.linalg.slogdet(covariance)[1])
    factors = rng.uniform(1.0, 5.0, 12)
    wider = noise.widened(factors).whiten(np.eye(12))
    covariance = np.eye(12) + (dense @ dense.T) / np.outer(factors, factors)
    np.testing.assert_allclose(wider @ covariance @ wider.T, np.eye(12), atol=1e-9)


def test_dependent_patterns_are_no_trouble() -> None:
    pattern = np.arange(6.0)[:, None]
    twice = CorrelatedNoise(np.hstack([pattern, pattern]))
    once = CorrelatedNoise(np.sqrt(2.0) * pattern)
    values = np.random.default_rng(0).standard_normal(6)
    np.testing.assert_allclose(twice.whiten(values), once.whiten(values), atol=1e-12)


def test_a_widened_noise_leaves_the_common_error_as_large() -> None:
    rng = np.random.default_rng(1)
    patterns, factors = rng.standard_normal((8, 2)), rng.uniform(1.0, 5.0, 8)
    found = CorrelatedNoise(patterns).widened(factors).whiten(np.eye(8))
    expected = CorrelatedNoise(patterns / factors[:, None]).whiten(np.eye(8))
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_products_of_the_jacobian_are_whitened_alike(
    recording: Recording, moduli: np.ndarray
) -> None:
    problem = InverseProblem(recording)
    plain = problem.evaluate(moduli)
    rng = np.random.default_rng(0)
    common = CorrelatedNoise(rng.standard_normal((problem.n_data, 3)))
    problem = problem.with_data(replace(problem.data, correlated=common))
    at = problem.evaluate(moduli)
    np.testing.assert_allclose(at.residuals, common.whiten(plain.residuals), rtol=1e-10)
    jacobian = common.whiten(plain.jacobian())
    np.testing.assert_allclose(at.jacobian(), jacobian, rtol=0, atol=1e-9 * np.abs(jacobian).max())
    change, weights = rng.standard_normal(len(moduli)), rng.standard_normal(problem.n_data)
    assert at.jacobian_times(change) == pytest.approx(jacobian @ change, rel=1e-7, abs=1e-9)
    assert at.transpose_times(weights) == pytest.approx(jacobian.T @ weights, rel=1e-7, abs=1e-9)
    np.testing.assert_allclose(at.gradient(), jacobian.T @ at.residuals, rtol=1e-6)

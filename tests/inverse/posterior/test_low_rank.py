from collections.abc import Callable

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st

from tactorch.errors import ConfigError
from tactorch.inverse import (
    PRIORS,
    InverseProblem,
    Log,
    NoiseModel,
    NuisancePrior,
    Objective,
)
from tactorch.inverse.fields import ElementField
from tactorch.inverse.posterior import LaplacePosterior, LowRankPosterior
from tactorch.linalg.superlu import SparseFactor

LOG = Log()
M, DATA = 30, 12


def sparse_precision(seed: int, size: int = M) -> sp.csr_matrix:
    rng = np.random.default_rng(seed)
    root = sp.random(size, size, 0.1, random_state=rng) + sp.eye(size)
    # Bounded below: round-off in ill-conditioned pencils is that of any dense solver as well.
    return sp.csr_matrix(root @ root.T + 0.1 * sp.eye(size))


def model(seed: int) -> tuple[np.ndarray, sp.csr_matrix, np.ndarray]:
    """Jacobian, the prior's precision, and the exact covariance."""
    jacobian = np.random.default_rng([seed, 1]).normal(size=(DATA, M))
    precision = sparse_precision(seed)
    return jacobian, precision, np.linalg.inv(jacobian.T @ jacobian + precision.toarray())


def low_rank(jacobian: np.ndarray, precision: sp.csr_matrix, rank: int) -> LowRankPosterior:
    return LowRankPosterior.of(
        np.zeros(M), lambda v: jacobian.T @ (jacobian @ v), precision, LOG, rank
    )


@settings(deadline=None, max_examples=10)
@given(st.integers(0, 2**31), st.integers(1, 60))
def test_selected_inverse_is_the_inverse(seed: int, size: int) -> None:
    matrix = sparse_precision(seed, size)
    factor = SparseFactor.of(matrix)
    assert factor is not None
    dense = matrix.toarray()
    np.testing.assert_allclose(factor.inverse_diagonal, np.linalg.inv(dense).diagonal(), rtol=1e-9)
    # Draws are a linear map of the noise, whose square must be the covariance.
    root = factor.correlated(np.eye(size))
    np.testing.assert_allclose(root @ root.T, np.linalg.inv(dense), atol=1e-9)


def test_matrices_that_are_not_positive_definite_have_no_factor() -> None:
    assert SparseFactor.of(sp.csr_matrix(np.diag([1.0, -1.0]))) is None
    assert SparseFactor.of(sp.csr_matrix([[0.0, 1.0], [1.0, 0.0]])) is None
    assert SparseFactor.of(sp.csr_matrix([[1.0, -1.0], [-1.0, 1.0]])) is None


@settings(deadline=None, max_examples=8)
@given(st.integers(0, 2**31))
def test_equals_the_dense_posterior_where_the_rank_suffices(seed: int) -> None:
    jacobian, precision, exact = model(seed)
    dense = LaplacePosterior.of(np.zeros(M), jacobian, precision, LOG)
    found = low_rank(jacobian, precision, DATA)
    some = np.array([4, 1, 29])
    for name in ("variance", "deviation", "resolution_diagonal"):
        np.testing.assert_allclose(getattr(found, name)(), getattr(dense, name)(), rtol=1e-6)
    np.testing.assert_allclose(found.covariance(some), exact[np.ix_(some, some)], atol=1e-8)
    np.testing.assert_allclose(found.interval(0.9), dense.interval(0.9), rtol=1e-6)
    assert np.all(low_rank(jacobian, precision, DATA + 1).excess() < 1e-9)


@settings(deadline=None, max_examples=8)
@given(st.integers(0, 2**31), st.integers(1, DATA - 1))
def test_too_low_a_rank_errs_on_the_safe_side_by_no_more_than_stated(seed: int, rank: int) -> None:
    jacobian, precision, exact = model(seed)
    found, more = low_rank(jacobian, precision, rank), low_rank(jacobian, precision, rank + 1)
    excess = found.variance() - exact.diagonal()
    prior = found.factor.inverse_diagonal[:M]
    assert np.all(excess >= -1e-9 * prior)
    assert np.all(excess <= found.excess() + 1e-9 * prior)
    assert np.all(more.variance() <= found.variance() + 1e-9 * prior)
    assert np.all(found.variance() <= prior)


def test_draws_have_the_covariance() -> None:
    jacobian, precision, exact = model(3)
    drawn = low_rank(jacobian, precision, DATA).sample(np.random.default_rng(0), 40_000)
    np.testing.assert_allclose(np.cov(drawn.T), exact, atol=0.03 * exact.max())


@pytest.mark.parametrize("unknowns", [NuisancePrior(), NuisancePrior(force_scale=0.1)])
@pytest.mark.parametrize("name", ["total_variation", "smoothness"])
def test_at_a_point_equals_the_dense_posterior(
    make_problem: Callable[..., InverseProblem],
    name: str,
    unknowns: NuisancePrior,
    moduli: np.ndarray,
) -> None:
    # Coarse data: directions that are left out must be those of which they say little.
    recording = make_problem(faces=("z+", "x-")).recording
    problem = InverseProblem(recording, noise=NoiseModel(relative=0.1))
    prior = PRIORS.build(name).on(problem.recording.mesh)
    objective = Objective(problem, ElementField(LOG, prior, problem.n_elements), unknowns)
    x = objective.start(moduli)
    point = objective.at(x)
    found = LowRankPosterior.at(point, 5.0, rank=len(x) - 1)
    dense = LaplacePosterior.at(point, 5.0)
    np.testing.assert_allclose(found.variance(), dense.variance(), rtol=1e-4)
    assert found.sample(np.random.default_rng(0), 2).shape == (2, 40)
    # The prior alone would leave the mean wide open.
    assert np.all(found.factor.inverse_diagonal[:40] > 50.0)


def test_refusals(make_problem: Callable[..., InverseProblem], moduli: np.ndarray) -> None:
    jacobian, precision, _ = model(0)
    for rank in (0, M):
        with pytest.raises(ConfigError, match=f"rank={rank}"):
            low_rank(jacobian, precision, rank)
    with pytest.raises(ConfigError, match="not positive definite"):
        low_rank(jacobian, sp.csr_matrix((M, M)), 3)
    problem = make_problem()
    point = Objective(
        problem,
        ElementField(LOG, PRIORS.build("none").on(problem.recording.mesh), problem.n_elements),
    ).at(np.log(moduli))
    with pytest.raises(ConfigError, match="weight=-1"):
        LowRankPosterior.at(point, -1.0)

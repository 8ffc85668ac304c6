"""The one iteration: vectors and batches, NumPy and torch, truncation, negative curvature."""

import numpy as np
import pytest
import torch

from tactorch.linalg import conjugate_gradients


def definite(size=12, seed=0):
    root = np.random.default_rng(seed).standard_normal((size, size))
    return root @ root.T + np.eye(size)


def identity(r):
    return r


@pytest.mark.parametrize("preconditioned_norm", [False, True])
@pytest.mark.parametrize("orthogonalize", [False, True])
def test_solution_and_image_are_those_of_the_dense_matrix(preconditioned_norm, orthogonalize):
    matrix, rhs = definite(), np.random.default_rng(1).standard_normal(12)
    before = rhs.copy()
    result = conjugate_gradients(
        lambda v: matrix @ v, lambda r: r / 3.0, rhs, rtol=1e-10, max_iterations=50,
        preconditioned_norm=preconditioned_norm, orthogonalize=orthogonalize,
    )  # fmt: skip
    assert result.converged
    assert not result.negative_curvature
    assert result.iterations <= 20
    np.testing.assert_allclose(result.solution, np.linalg.solve(matrix, rhs), rtol=1e-6)
    np.testing.assert_allclose(result.image, matrix @ result.solution, rtol=1e-9, atol=1e-10)
    np.testing.assert_array_equal(rhs, before)


def test_orthogonal_residuals_end_after_as_many_iterations_as_unknowns():
    matrix, rhs = np.diag(np.logspace(0, 9, 12)), np.ones(12)
    plain, orthogonal = (
        conjugate_gradients(
            lambda v: matrix @ v, identity, rhs, rtol=1e-11, max_iterations=200, orthogonalize=keep
        )
        for keep in (False, True)
    )
    assert orthogonal.converged
    assert orthogonal.iterations <= 14 < plain.iterations


@pytest.mark.parametrize("make", [np.asarray, torch.from_numpy])
def test_columns_of_a_batch_are_solved_as_vectors(make):
    matrix, rhs = definite(), np.random.default_rng(1).standard_normal((12, 3))
    rhs[:, 1] = 0.0
    operator = make(matrix)
    batch = conjugate_gradients(
        lambda v: operator @ v, identity, make(rhs), rtol=1e-12, max_iterations=50
    )
    assert batch.converged
    np.testing.assert_allclose(
        np.asarray(batch.solution), np.linalg.solve(matrix, rhs), rtol=1e-6, atol=1e-12
    )
    np.testing.assert_array_equal(np.asarray(batch.solution)[:, 1], 0.0)


def test_a_looser_tolerance_takes_fewer_iterations():
    matrix, rhs = definite(40), np.ones(40)
    few, many = (
        conjugate_gradients(lambda v: matrix @ v, identity, rhs, rtol=rtol, max_iterations=100)
        for rtol in (0.1, 1e-10)
    )
    assert few.iterations < many.iterations
    off = np.linalg.norm(matrix @ few.solution - rhs) / np.linalg.norm(rhs)
    assert 1e-4 < off <= 0.1


def test_the_limit_of_iterations_is_reported():
    matrix = definite(40)
    result = conjugate_gradients(
        lambda v: matrix @ v, identity, np.ones(40), rtol=1e-12, max_iterations=3
    )
    assert result.iterations == 3
    assert not result.converged


def test_negative_curvature_truncates_to_a_descent_step():
    matrix, rhs = np.diag([1.0, 2.0, -1.0]), -np.array([1.0, 1.0, 1e-3])
    result = conjugate_gradients(lambda v: matrix @ v, identity, rhs, rtol=1e-12, max_iterations=50)
    assert result.negative_curvature
    assert not result.converged
    assert rhs @ result.solution > 0
    np.testing.assert_allclose(result.image, matrix @ result.solution)
    first = conjugate_gradients(lambda v: -v, identity, rhs, rtol=1e-12, max_iterations=50)
    np.testing.assert_allclose(first.solution, rhs)
    np.testing.assert_allclose(first.image, -rhs)


def test_negative_curvature_in_one_column_leaves_the_others():
    signs = torch.tensor([1.0, -1.0], dtype=torch.float64)
    rhs = torch.ones(6, 2, dtype=torch.float64)
    result = conjugate_gradients(
        lambda v: 2.0 * signs * v, identity, rhs, rtol=1e-12, max_iterations=50
    )
    assert result.negative_curvature
    torch.testing.assert_close(result.solution[:, 0], 0.5 * rhs[:, 0])
    torch.testing.assert_close(result.solution[:, 1], rhs[:, 1])

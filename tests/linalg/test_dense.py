import numpy as np
import pytest

from tactorch.linalg.dense import DenseCholesky, column_rank, dot


def test_solution_is_that_of_numpy():
    rng = np.random.default_rng(0)
    A = rng.standard_normal((30, 30))
    matrix, rhs = A @ A.T + np.eye(30), rng.standard_normal(30)
    kept = matrix.copy()
    x = DenseCholesky.of(matrix).solve(rhs)
    np.testing.assert_allclose(x, np.linalg.solve(matrix, rhs), rtol=1e-9)
    np.testing.assert_array_equal(matrix, kept)


def test_indefinite_matrices_have_no_factor():
    assert DenseCholesky.of(np.diag([1.0, -1e-3, 2.0])) is None


def test_products_are_those_of_numpy():
    a, b = np.random.default_rng(0).standard_normal((2, 20_000))
    assert dot(a, b) == pytest.approx(float(a @ b), rel=1e-10)
    with pytest.raises(Exception, match=r"scalar product|Type-check"):
        dot(a, b[:-1])


@pytest.mark.parametrize("rank", range(7))
def test_rank_is_that_of_the_singular_values(rank):
    rng = np.random.default_rng(rank)
    columns = rng.standard_normal((30, rank)) @ rng.standard_normal((rank, 6))
    before = columns.copy()
    assert column_rank(columns, 1e-8) == np.linalg.matrix_rank(columns, tol=1e-8) == rank
    np.testing.assert_array_equal(columns, before)


def test_a_column_below_the_tolerance_does_not_count():
    columns = np.diag([1.0, 1e-3, 1e-9])
    assert column_rank(columns, 1e-8) == 2
    assert column_rank(columns, 1e-10) == 3

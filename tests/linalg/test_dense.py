import numpy as np

from tactorch.linalg import DenseCholesky


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

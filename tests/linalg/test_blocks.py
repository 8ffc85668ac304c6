"""Products of symmetric matrices of 3 x 3 blocks."""

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st

from tactorch.linalg.blocks import BlockMatrix, upper_blocks
from tactorch.linalg.pattern import SymmetricPattern


def _symmetric(seed: int, nodes: int, density: float) -> sp.bsr_matrix:
    rng = np.random.default_rng(seed)
    coupled = rng.random((nodes, nodes)) < density
    coupled = coupled | coupled.T | np.eye(nodes, dtype=bool)
    dense = rng.standard_normal((3 * nodes, 3 * nodes)) * np.kron(coupled, np.ones((3, 3)))
    return sp.bsr_matrix(sp.csr_matrix(dense + dense.T), blocksize=(3, 3))


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 1000), st.integers(1, 30), st.floats(0.0, 1.0))
def test_the_product_is_that_of_both_triangles(seed, nodes, density):
    matrix = _symmetric(seed, nodes, density)
    matrix.sort_indices()
    x = np.random.default_rng(seed).standard_normal(3 * nodes).astype(np.float32)
    blocks = BlockMatrix.of(matrix)
    assert len(blocks.indices) == (matrix.nnz // 9 + nodes) // 2
    found = blocks @ x
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, matrix @ x.astype(float), atol=1e-4)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 1000), st.integers(1, 30), st.floats(0.0, 1.0))
def test_the_upper_triangle_has_all_blocks(seed, nodes, density):
    matrix = _symmetric(seed, nodes, density)
    upper = sp.csr_matrix(sp.triu(matrix))
    upper.sort_indices()
    blocks = upper_blocks(SymmetricPattern(upper.indptr, upper.indices), upper.data)
    expected = np.triu(np.ones((nodes, nodes))).repeat(3, axis=0).repeat(3, axis=1)
    np.testing.assert_array_equal(blocks.toarray(), matrix.toarray() * expected)
    matrix.sort_indices()
    found, same = BlockMatrix.of(blocks), BlockMatrix.of(matrix)
    np.testing.assert_array_equal(found.values, same.values)
    np.testing.assert_array_equal(found.indices, same.indices)


@pytest.mark.parametrize("rows", [1, 7])
def test_a_diagonal_of_blocks_is_applied_block_by_block(rows):
    rng = np.random.default_rng(rows)
    blocks = rng.standard_normal((rows, 3, 3))
    x = rng.standard_normal(3 * rows).astype(np.float32)
    places = np.arange(rows + 1)
    diagonal = BlockMatrix.of(sp.bsr_matrix((blocks, places[:-1], places)))
    expected = np.einsum("bij,bj->bi", blocks, x.reshape(-1, 3)).ravel()
    np.testing.assert_allclose(diagonal @ x, expected, rtol=1e-5, atol=1e-6)

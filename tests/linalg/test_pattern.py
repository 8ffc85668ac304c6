import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from tactorch.linalg import SymmetricPattern


@st.composite
def systems(draw):
    """A pattern with values, and the dense matrix they stand for."""
    size = draw(st.integers(1, 12))
    pairs = draw(st.lists(st.tuples(*[st.integers(0, size - 1)] * 2), max_size=40))
    rows, cols = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    pattern = SymmetricPattern.from_pairs(size, rows, cols)
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    values = rng.standard_normal(pattern.nnz)
    dense = np.zeros((size, size))
    for row, col, value in zip(pattern.rows, pattern.indices, values, strict=True):
        dense[row, col] = dense[col, row] = value
    return pattern, values, dense, set(pairs)


@given(systems())
@settings(max_examples=60)
def test_pattern_is_the_upper_triangle_with_every_diagonal_entry_first_in_its_row(system):
    pattern, _, _, pairs = system
    stored = list(zip(pattern.rows.tolist(), pattern.indices.tolist(), strict=True))
    diagonal = {(i, i) for i in range(pattern.size)}
    assert stored == sorted({(min(p), max(p)) for p in pairs} | diagonal)
    np.testing.assert_array_equal(pattern.indices[pattern.diagonal], np.arange(pattern.size))


@given(systems())
@settings(max_examples=60)
def test_full_is_the_dense_matrix(system):
    pattern, values, dense, _ = system
    full = pattern.full(values)
    np.testing.assert_array_equal(full.toarray(), dense)
    rows = np.split(full.indices, full.indptr[1:-1])
    assert all((np.diff(row) > 0).all() for row in rows)  # as numerical solvers expect


@given(systems(), st.integers(1, 3))
@settings(max_examples=60)
def test_product_is_the_dense_product(system, columns):
    pattern, values, dense, _ = system
    x = np.random.default_rng(0).standard_normal((pattern.size, columns))
    np.testing.assert_allclose(pattern.product(values, x), dense @ x, atol=1e-12)
    np.testing.assert_allclose(pattern.product(values, x[:, 0]), dense @ x[:, 0], atol=1e-12)


@given(systems())
@settings(max_examples=60)
def test_slots_find_a_coupling_from_either_triangle(system):
    pattern, values, dense, _ = system
    rows, cols = pattern.rows, pattern.indices
    np.testing.assert_array_equal(values[pattern.slots(rows, cols)], dense[rows, cols])
    np.testing.assert_array_equal(pattern.slots(cols, rows), pattern.slots(rows, cols))


@given(systems(), st.integers(1, 3))
@settings(max_examples=60)
def test_blocks_replace_every_coupling(system, size):
    pattern, _, _, pairs = system
    wide = pattern.blocks(size)
    offsets = np.arange(size)
    rows, cols = np.array([*pairs, *zip(*[range(pattern.size)] * 2, strict=True)]).T
    rows = size * rows[:, None, None] + offsets[:, None] + 0 * offsets
    cols = size * cols[:, None, None] + offsets + 0 * offsets[:, None]
    expected = SymmetricPattern.from_pairs(size * pattern.size, rows, cols)
    np.testing.assert_array_equal(wide.indptr, expected.indptr)
    np.testing.assert_array_equal(wide.indices, expected.indices)


def test_large_sizes_do_not_overflow():
    size = 100_000  # size^2 is beyond 32 bits
    rows = np.array([0, size - 2], dtype=np.int32)
    cols = np.array([size - 1, size - 1], dtype=np.int32)
    pattern = SymmetricPattern.from_pairs(size, rows, cols)
    assert pattern.nnz == size + 2
    np.testing.assert_array_equal(pattern.indices[pattern.slots(rows, cols)], size - 1)
    np.testing.assert_array_equal(pattern.rows[pattern.slots(rows, cols)], [0, size - 2])


@given(systems(), st.integers(0, 2**32 - 1))
@settings(max_examples=60)
def test_holding_reduces_rows_and_columns_to_a_positive_diagonal(system, seed):
    pattern, values, dense, _ = system
    fixed = np.random.default_rng(seed).random(pattern.size) < 0.4
    held = pattern.full(pattern.apply_dirichlet(values, fixed)).toarray()
    free = ~fixed
    np.testing.assert_array_equal(held[np.ix_(free, free)], dense[np.ix_(free, free)])
    np.testing.assert_array_equal(held[np.ix_(fixed, free)], 0.0)
    np.testing.assert_array_equal(held[fixed], np.diag(np.diag(held))[fixed])
    assert np.all(np.diag(held)[fixed] > 0)

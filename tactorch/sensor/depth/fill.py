"""Filling what markers hide."""

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float
from scipy.sparse.linalg import spsolve

from tactorch.errors import ConfigError


def filled(
    values: Float[np.ndarray, "h w"], known: Bool[np.ndarray, "h w"]
) -> Float[np.ndarray, "h w"]:
    """Return a field whose unknown pixels are as smooth as the known ones around allow.

    Unknown pixels are the mean of their neighbours (Laplace's equation); the image's edge is free.

    Args:
        values: The field; what it holds at unknown pixels does not matter.
        known: Which pixels are known.

    Raises:
        ConfigError: Shapes differ, or no pixel is known.
    """
    if values.shape != known.shape:
        raise ConfigError(f"values are {values.shape}, known is {known.shape}.")
    if not known.any():
        raise ConfigError("no pixel is known; is everything masked as a marker?")
    if known.all():
        return values.copy()
    numbers = np.full(values.shape, -1)
    numbers[~known] = np.arange(int((~known).sum()))
    matrix, right = _equations(values, numbers)
    found = values.copy()
    found[~known] = spsolve(matrix.tocsc(), right)
    return found


def _equations(values: np.ndarray, numbers: np.ndarray) -> tuple[sp.coo_matrix, np.ndarray]:
    count = int(numbers.max()) + 1
    right, degree = np.zeros(count), np.zeros(count)
    rows, columns = [], []
    flat, own = values.ravel(), numbers.ravel()
    places = np.arange(values.size).reshape(values.shape)
    pairs = [(places[:, 1:], places[:, :-1]), (places[1:], places[:-1])]
    for one, other in [*pairs, *[(b, a) for a, b in pairs]]:
        here, there = one.ravel(), other.ravel()
        mine = own[here] >= 0
        here, there = here[mine], there[mine]
        np.add.at(degree, own[here], 1.0)
        unknown = own[there] >= 0
        np.add.at(right, own[here[~unknown]], flat[there[~unknown]])
        rows.append(own[here[unknown]])
        columns.append(own[there[unknown]])
    row, column = np.concatenate(rows), np.concatenate(columns)
    off = sp.coo_matrix((-np.ones(len(row)), (row, column)), shape=(count, count))
    return (off + sp.diags(degree)).tocoo(), right

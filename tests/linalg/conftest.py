from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from tactorch.fem import ELEMENTS, Discretisation
from tactorch.linalg import SymmetricPattern
from tactorch.mesh import box_mesh


@dataclass(frozen=True)
class System:
    """A sparse symmetric matrix in both forms."""

    pattern: SymmetricPattern
    values: np.ndarray

    @property
    def dense(self) -> np.ndarray:
        upper = np.zeros((self.pattern.size,) * 2)
        upper[self.pattern.rows, self.pattern.indices] = self.values
        return upper + np.triu(upper, 1).T


def spring_lattice(seed: int) -> System:
    """Positive definite matrix on the pattern of a small mesh: random springs and a ground."""
    d = Discretisation(box_mesh(1.0, 2), ELEMENTS["tet4"])
    pattern = d.pattern
    values = np.random.default_rng(seed).uniform(-1.0, 1.0, pattern.nnz)
    sums = np.zeros(pattern.size)
    off = pattern.rows != pattern.indices
    np.add.at(sums, pattern.rows[off], np.abs(values[off]))
    np.add.at(sums, pattern.indices[off], np.abs(values[off]))
    values[pattern.diagonal] = sums + 0.5
    return System(pattern, values)


@pytest.fixture
def lattice() -> Callable[[int], System]:
    return spring_lattice

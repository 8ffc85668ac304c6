"""Averages over tetrahedra, by points spread evenly in each."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.mesh import TetMesh

# Points evaluated at once; bounds the memory.
_CHUNK = 500_000


def lattice(samples: int) -> Float[np.ndarray, "p 4"]:
    """Return barycentric coordinates of an even lattice within a tetrahedron.

    There are `samples` points along an edge, samples (samples + 1) (samples + 2) / 6 in all: the
    centroid alone for 1, four for 2, ten for 3.

    Raises:
        ConfigError: `samples` is below 1.
    """
    if samples < 1:
        raise ConfigError(f"samples={samples} must be at least 1.")
    r = range(samples)
    counts = [(i, j, k, samples - 1 - i - j - k) for i in r for j in r for k in r]
    kept = np.array([row for row in counts if row[3] >= 0])
    return (kept + 0.25) / samples


def element_means(
    mesh: TetMesh,
    values_at: Callable[[Float[np.ndarray, "k 3"]], Float[np.ndarray, " k"]],
    samples: int,
) -> Float[np.ndarray, " m"]:
    """Return the mean over each element of a field, sampled at `lattice(samples)`."""
    shares = lattice(samples)
    means = np.empty(mesh.n_tets)
    step = max(1, _CHUNK // len(shares))
    for start in range(0, mesh.n_tets, step):
        corners = mesh.points[mesh.tets[start : start + step]]
        points = np.einsum("pc,mcd->mpd", shares, corners).reshape(-1, 3)
        means[start : start + step] = values_at(points).reshape(-1, len(shares)).mean(axis=1)
    return means

"""Averages of fields over tetrahedra, from points on an even lattice in each element."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.mesh.tetmesh import TetMesh
from tactorch.mesh.values import Points

Field = Callable[[Points], Float[np.ndarray, " n"]]
# Points evaluated at once; limits the memory.
_MAX_POINTS = 500_000
_SAMPLES = 6  # points of the lattice along an edge, of which those around a quadrature point are


def lattice(
    samples: int, margin: float | None = None, corners: int = 4
) -> Float[np.ndarray, "p corners"]:
    """Return barycentric coordinates of an even lattice within a tetrahedron (or triangle).

    There are `samples` points along an edge, samples (samples + 1) (samples + 2) / 6 in all: the
    centroid alone for 1, four for 2, ten for 3. The margin to the faces, in steps of the lattice,
    makes by default the mean of a quadratic exact; for 2 this is the four-point Gauss rule.
    """
    if samples < 1:
        raise ConfigError(f"samples={samples} must be at least 1.")
    n = samples - 1
    free = np.indices((samples,) * (corners - 1)).reshape(corners - 1, -1).T
    counts = np.column_stack((free, n - free.sum(axis=1)))
    counts = counts[counts[:, -1] >= 0]
    if margin is None:
        # The positive root of margin^2 + n margin / 2 = n / 4 makes the mean of L^2 one tenth.
        margin = (np.sqrt(0.25 * n * n + n) - 0.5 * n) / 2.0 if n else 0.25
    return (counts + margin) / (n + corners * margin)


def samples_around(rule: Float[np.ndarray, "q 4"]) -> Float[np.ndarray, "p 4"]:
    """Return as many points of an element for each quadrature point, those nearest to it.

    They are of a lattice. Those that are nearest to two quadrature points count half for each: the
    others are there twice.
    """
    points = lattice(_SAMPLES)
    distance = ((points[:, None] - rule) ** 2).sum(axis=2)
    nearest = np.isclose(distance, distance.min(axis=1, keepdims=True))
    counts = 2 // nearest.sum(axis=1, keepdims=True) * nearest
    groups = [np.repeat(np.arange(len(points)), count) for count in counts.T]
    return points[np.concatenate(groups)]


def element_means(mesh: TetMesh, values_at: Field, samples: int) -> Float[np.ndarray, " m"]:
    """Return the mean of a field over each element, from `samples` points along an edge."""
    return _means(mesh, values_at, lattice(samples), 1)[:, 0]


def quadrature_means(
    mesh: TetMesh, values_at: Field, rule: Float[np.ndarray, "q 4"]
) -> Float[np.ndarray, "m q"]:
    """Return the mean of a field over the part of each element nearest to each quadrature point.

    See `samples_around`.
    """
    return _means(mesh, values_at, samples_around(rule), len(rule))


def _means(
    mesh: TetMesh,
    values_at: Field,
    weights: Float[np.ndarray, "p 4"],
    groups: int,
) -> Float[np.ndarray, "m groups"]:
    """Return the means of a field over equal groups of points of each element."""
    means = np.empty((mesh.n_tets, groups))
    step = max(1, _MAX_POINTS // len(weights))
    for start in range(0, mesh.n_tets, step):
        corners = mesh.points[mesh.tets[start : start + step]]
        points = np.einsum("pc,mcd->mpd", weights, corners).reshape(-1, 3)
        values = values_at(points).reshape(len(corners), groups, -1)
        means[start : start + step] = values.mean(axis=2)
    return means

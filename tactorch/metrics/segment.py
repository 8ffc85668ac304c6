"""Segmentation of a map: elements past half way from the background to the extreme.

The background is the volume-weighted median. The extreme is taken of the field averaged over each
element and its face neighbours, since reconstructions often leave single elements at a bound.
Elements are then compared by their own modulus, so that a field of two levels is cut exactly
between them, down to an inclusion of one element.
"""

from typing import Literal

import numpy as np
from jaxtyping import Bool, Float
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tactorch.mesh import TetMesh

Side = Literal["stiff", "soft"]

# Smallest relative distance of the extreme from the background in a field with an inclusion.
MIN_CONTRAST = 0.02


def inclusion_side(mesh: TetMesh, values: Float[np.ndarray, " m"]) -> Side | None:
    """Return whether the field's inclusion is stiff or soft; None if it has none.

    The side is that of the extreme with the larger ratio to the background.
    """
    background, low, high = _levels(mesh, values)
    stiffer, softer = high / background, background / low
    if max(stiffer, softer) <= 1 + MIN_CONTRAST:
        return None
    return "stiff" if stiffer >= softer else "soft"


def segment(mesh: TetMesh, values: Float[np.ndarray, " m"], side: Side) -> Bool[np.ndarray, " m"]:
    """Return the elements past half way from the background to the extreme on `side`.

    An inclusion fills less than half of the body. The mask is empty if nothing stands out.
    """
    background, low, high = _levels(mesh, values)
    if side == "stiff" and high > background * (1 + MIN_CONTRAST):
        return values > (background + high) / 2
    if side == "soft" and low * (1 + MIN_CONTRAST) < background:
        return values < (background + low) / 2
    return np.zeros(len(values), dtype=bool)


def volume_mean(
    mesh: TetMesh, values: Float[np.ndarray, " m ..."], mask: Bool[np.ndarray, " m"]
) -> Float[np.ndarray, "..."]:
    """Average `values` over the volume of the elements in `mask`."""
    return np.asarray(np.average(values[mask], axis=0, weights=mesh.volumes[mask]))


def weighted_median(values: Float[np.ndarray, " m"], weights: Float[np.ndarray, " m"]) -> float:
    """Return the value below which half of the weight lies."""
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order])
    # The slack absorbs round-off where exactly half of the weight is reached.
    return float(values[order[np.searchsorted(total, total[-1] * 0.5 * (1 - 1e-12))]])


def neighbourhood_mean(mesh: TetMesh, values: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
    """Average over the volume of each element and those that share a face with it."""
    first, second = mesh.adjacency.pairs.T
    volumes = mesh.volumes.copy()
    moments = mesh.volumes * values
    for element, neighbour in ((first, second), (second, first)):
        volumes += np.bincount(element, weights=mesh.volumes[neighbour], minlength=mesh.n_tets)
        weights = (mesh.volumes * values)[neighbour]
        moments += np.bincount(element, weights=weights, minlength=mesh.n_tets)
    return moments / volumes


def connected_parts(mesh: TetMesh, mask: Bool[np.ndarray, " m"]) -> list[Bool[np.ndarray, " m"]]:
    """Return the masks of the face-connected parts of `mask`."""
    pairs = mesh.adjacency.pairs
    inner = pairs[mask[pairs].all(axis=1)]
    graph = coo_array((np.ones(len(inner)), (inner[:, 0], inner[:, 1])), shape=(mesh.n_tets,) * 2)
    _, labels = connected_components(graph, directed=False)
    return [mask & (labels == label) for label in np.unique(labels[mask])]


def _levels(mesh: TetMesh, values: Float[np.ndarray, " m"]) -> tuple[float, float, float]:
    """Background, lowest and highest level."""
    background = weighted_median(values, mesh.volumes)
    means = neighbourhood_mean(mesh, values)
    return background, float(means.min()), float(means.max())

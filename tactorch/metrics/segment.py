"""Which elements stand out: past half way from the background to the extreme.

Background is the median over the volume. The extreme is taken of the field averaged over each
element and its face neighbours: reconstructions often leave a single element at a bound, which
would otherwise decide both the side (stiff or soft) and the height. The elements themselves are
then judged by their own modulus, so that a field of two levels is cut exactly between them, down
to an inclusion of one element.
"""

from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from tactorch.mesh import TetMesh

Side = Literal["stiff", "soft"]

# Fields whose extreme is within this of the background, relatively, have no inclusion.
LEAST_CONTRAST = 0.02


def standing_out(mesh: TetMesh, values: Float[np.ndarray, " m"]) -> Side | None:
    """Tell whether the field's inclusion is stiff or soft, or None where it has none.

    The side is that of the extreme farther from the background by ratio.
    """
    background, low, high = _levels(mesh, values)
    stiffer, softer = high / background, background / low
    if max(stiffer, softer) <= 1 + LEAST_CONTRAST:
        return None
    return "stiff" if stiffer >= softer else "soft"


def segment(mesh: TetMesh, values: Float[np.ndarray, " m"], side: Side) -> Bool[np.ndarray, " m"]:
    """Return the elements past half way from the background to the extreme on `side`.

    An inclusion must fill less than half of the body, or it is the background. Empty where
    nothing stands out on that side.
    """
    background, low, high = _levels(mesh, values)
    if side == "stiff" and high > background * (1 + LEAST_CONTRAST):
        return values > (background + high) / 2
    if side == "soft" and low * (1 + LEAST_CONTRAST) < background:
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
    reached = np.cumsum(weights[order])
    # The slack lets a half that is reached up to round-off count as reached.
    return float(values[order[np.searchsorted(reached, reached[-1] * 0.5 * (1 - 1e-12))]])


def neighbourhood_mean(mesh: TetMesh, values: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
    """Average over the volume of each element and those that share a face with it."""
    one, other = mesh.adjacency.pairs.T
    volumes = mesh.volumes.copy()
    moments = mesh.volumes * values
    for here, there in ((one, other), (other, one)):
        volumes += np.bincount(here, weights=mesh.volumes[there], minlength=mesh.n_tets)
        moments += np.bincount(here, weights=(mesh.volumes * values)[there], minlength=mesh.n_tets)
    return moments / volumes


def _levels(mesh: TetMesh, values: Float[np.ndarray, " m"]) -> tuple[float, float, float]:
    """Return background, lowest and highest level."""
    background = weighted_median(values, mesh.volumes)
    around = neighbourhood_mean(mesh, values)
    return background, float(around.min()), float(around.max())

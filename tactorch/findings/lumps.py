"""Conspicuous regions of a map, by a threshold that is robust to single outliers.

In the logarithm of the moduli, two levels are sought that leave the least absolute deviation: what
surrounds and what stands out, each the median over its volume. The threshold lies half way between
them, and is moved until it stays (Ridler and Calvard, 1978). A map that overshoots in a few
elements, up to a bound, is cut where one that does not is.
"""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tactorch.errors import ConfigError
from tactorch.mesh import TetMesh
from tactorch.metrics import Inclusion
from tactorch.metrics.checks import check_on_mesh
from tactorch.metrics.segment import (
    LEAST_CONTRAST,
    Side,
    neighbourhood_mean,
    volume_mean,
    weighted_median,
)

#: Of the body's volume: what stands out must stay below, or it is what surrounds.
_MOST = 0.5
_ROUNDS, _CUTS = 50, 100
#: Of the first lump's contrast, in logarithms; fainter ones are not told.
_FAINT = 0.2


def find_lumps(
    mesh: TetMesh,
    youngs: Float[np.ndarray, " m"],
    *,
    most: int = 5,
    min_volume_fraction: float = 1e-3,
    side: Side | None = None,
) -> list[Inclusion]:
    """Find connected regions that are stiffer or softer than what surrounds them.

    Regions of both kinds compete by the logarithm of their contrast times their radius. Faint ones
    beside a conspicuous one are left out: maps waver where the presses say little.

    Args:
        mesh: The body, m elements.
        youngs: Moduli, (m,), MPa.
        most: How many at most.
        min_volume_fraction: Of the body's volume; smaller regions are left out.
        side: "stiff" or "soft" to look for one kind only.

    Returns:
        The regions, the most conspicuous first; none where nothing stands out by 2 %.

    Raises:
        MeshError: The field is not over the elements of the mesh, or a modulus not above 0.
        ConfigError: A setting cannot be used.
    """
    check_on_mesh(mesh, "youngs", youngs)
    if most < 1 or not 0 <= min_volume_fraction < 1:
        raise ConfigError(
            f"most={most}, min_volume_fraction={min_volume_fraction}: give at least 1, and 0 to 1."
        )
    sides: tuple[Side, ...] = ("stiff", "soft") if side is None else (side,)
    outstanding = {kind: threshold(mesh, youngs, kind) for kind in sides}
    plain = ~np.any(list(outstanding.values()), axis=0)
    # A map without a distinct level, such as noise, may be stiff and soft in single places only.
    background = (
        float(volume_mean(mesh, youngs, plain))
        if plain.any()
        else weighted_median(youngs, mesh.volumes)
    )
    found = [
        lump
        for kind, mask in outstanding.items()
        for lump in _regions(mesh, youngs, mask, background, kind, min_volume_fraction)
    ]
    ordered = sorted(found, key=_conspicuous, reverse=True)[:most]
    return [lump for lump in ordered if _strength(lump) > _FAINT * _strength(ordered[0])]


def find_lump(mesh: TetMesh, youngs: Float[np.ndarray, " m"]) -> Inclusion | None:
    """Find the most conspicuous of `find_lumps`; None where nothing stands out."""
    return next(iter(find_lumps(mesh, youngs, most=1)), None)


def threshold(mesh: TetMesh, youngs: Float[np.ndarray, " m"], side: Side) -> Bool[np.ndarray, " m"]:
    """Return the elements that stand out on one side; none where nothing does."""
    sign = 1.0 if side == "stiff" else -1.0
    values, volumes = sign * np.log(youngs), mesh.volumes
    background = weighted_median(values, volumes)
    highest = float(neighbourhood_mean(mesh, values).max())
    mask = np.zeros(len(values), dtype=bool)
    if highest - background < np.log1p(LEAST_CONTRAST):
        return mask
    level = _level(values, volumes, background)
    for _ in range(_ROUNDS):
        moved = values > (background + level) / 2
        if not moved.any() or volumes[moved].sum() > _MOST * volumes.sum():
            break
        if (moved == mask).all():
            break
        mask = moved
        level = weighted_median(values[mask], volumes[mask])
        background = weighted_median(values[~mask], volumes[~mask])
    return mask


def _level(
    values: Float[np.ndarray, " m"], volumes: Float[np.ndarray, " m"], background: float
) -> float:
    """Return the level that, beside the background's, leaves the least absolute deviation."""
    cuts = background + (values.max() - background) * (np.arange(_CUTS) + 0.5) / _CUTS
    best, found = -np.inf, float(values.max())
    for cut in cuts:
        above = values > cut
        if volumes[above].sum() > _MOST * volumes.sum():
            continue
        level = weighted_median(values[above], volumes[above])
        taken = values[above] - background - np.abs(values[above] - level)
        gain = float(volumes[above] @ taken)
        if gain > best:
            best, found = gain, level
    return found


def _regions(
    mesh: TetMesh,
    youngs: Float[np.ndarray, " m"],
    mask: Bool[np.ndarray, " m"],
    background: float,
    side: Side,
    min_volume_fraction: float,
) -> list[Inclusion]:
    """The face-connected parts of a mask that are large enough."""
    found, least = [], min_volume_fraction * float(mesh.volumes.sum())
    sign = 1.0 if side == "stiff" else -1.0
    for elements in _parts(mesh, mask):
        volume = float(mesh.volumes[elements].sum())
        if volume >= least:
            found.append(
                Inclusion(
                    center_mm=_center(mesh, sign * np.log(youngs / background), elements),
                    volume_mm3=volume,
                    equivalent_radius_mm=float(np.cbrt(3 * volume / (4 * np.pi))),
                    mean_mpa=float(volume_mean(mesh, youngs, elements)),
                    background_mpa=background,
                    elements=elements,
                    side=side,
                )
            )
    return found


def _center(
    mesh: TetMesh, above: Float[np.ndarray, " m"], elements: Bool[np.ndarray, " m"]
) -> Float[np.ndarray, "3"]:
    """Centroid of a part and what touches it, by how far each element stands out.

    So elements that the boundary cuts count for what is within, and the centre does not jump by
    half an element where one passes the threshold.
    """
    weights = np.maximum(above, 0.0) * mesh.volumes * around(mesh, elements)
    return weights @ mesh.centroids / weights.sum()


def around(mesh: TetMesh, elements: Bool[np.ndarray, " m"]) -> Bool[np.ndarray, " m"]:
    """Return the elements and all that share a vertex with them; but never the whole body."""
    nodes = np.zeros(mesh.n_points, dtype=bool)
    nodes[mesh.tets[elements]] = True
    near = nodes[mesh.tets].any(axis=1)
    return elements if near.all() else near


def _parts(mesh: TetMesh, mask: Bool[np.ndarray, " m"]) -> list[Bool[np.ndarray, " m"]]:
    """Masks of the face-connected parts."""
    members: Int[np.ndarray, " k"] = np.flatnonzero(mask)
    pairs = mesh.adjacency.pairs
    kept = pairs[mask[pairs].all(axis=1)]
    graph = coo_array((np.ones(len(kept)), (kept[:, 0], kept[:, 1])), shape=(mesh.n_tets,) * 2)
    _, labels = connected_components(graph, directed=False)
    return [mask & (labels == label) for label in np.unique(labels[members])]


def _strength(lump: Inclusion) -> float:
    return abs(float(np.log(lump.contrast)))


def _conspicuous(lump: Inclusion) -> float:
    return _strength(lump) * lump.equivalent_radius_mm

"""Lumps of a map: the connected regions of its segmentation (`tactorch.metrics.segment`)."""

import numpy as np
from jaxtyping import Bool, Float

from tactorch.errors import ConfigError
from tactorch.mesh import TetMesh
from tactorch.metrics import Inclusion
from tactorch.metrics.segment import (
    Side,
    check_field,
    connected_parts,
    segment,
    volume_mean,
    weighted_median,
)

Field = Float[np.ndarray, " m"]
Mask = Bool[np.ndarray, " m"]
_MIN_RELATIVE_CONTRAST = 0.2  # log-contrast over that of the most conspicuous lump


def find_lumps(
    mesh: TetMesh,
    youngs: Field,
    *,
    max_lumps: int = 5,
    min_volume_fraction: float = 1e-3,
    side: Side | None = None,
) -> list[Inclusion]:
    """Find connected regions that are stiffer or softer than the background.

    Regions are in descending order of log-contrast times radius. Regions much fainter than the
    first are dropped, as maps fluctuate where the presses are insensitive. A map that varies by
    less than 2 % has none.

    Args:
        mesh: The body, m elements.
        youngs: Moduli, (m,), MPa.
        max_lumps: Largest number of regions.
        min_volume_fraction: Smallest volume of a region over that of the body.
        side: "stiff" or "soft" to find one kind only.
    """
    check_field("youngs", youngs, mesh)
    if max_lumps < 1 or not 0 <= min_volume_fraction < 1:
        raise ConfigError(
            f"max_lumps={max_lumps}, min_volume_fraction={min_volume_fraction}: give at least 1, "
            "and 0 to below 1."
        )
    sides: tuple[Side, ...] = ("stiff", "soft") if side is None else (side,)
    masks = {kind: segment(mesh, youngs, kind) for kind in sides}
    rest = ~np.any(list(masks.values()), axis=0)
    # In noise without a background, every element may be stiff or soft.
    background = weighted_median(youngs, mesh.volumes)
    if rest.any():
        background = float(volume_mean(mesh, youngs, rest))
    lumps = [
        _measure(mesh, youngs, elements, kind, background)
        for kind, mask in masks.items()
        for elements in connected_parts(mesh, mask)
        if mesh.volumes[elements].sum() >= min_volume_fraction * mesh.volumes.sum()
    ]
    lumps.sort(key=lambda lump: _log_contrast(lump) * lump.equivalent_radius_mm, reverse=True)
    min_contrast = _MIN_RELATIVE_CONTRAST * _log_contrast(lumps[0]) if lumps else 0.0
    return [lump for lump in lumps[:max_lumps] if _log_contrast(lump) > min_contrast]


def find_lump(mesh: TetMesh, youngs: Field) -> Inclusion | None:
    """Find the most conspicuous of `find_lumps`; None where nothing stands out."""
    return next(iter(find_lumps(mesh, youngs, max_lumps=1)), None)


def _measure(mesh: TetMesh, youngs: Field, mask: Mask, side: Side, background: float) -> Inclusion:
    """Return a part as an inclusion.

    Its centre is the centroid of the part and the adjacent elements, weighted by the excess over
    the background, so that it is continuous where an element passes the threshold.
    """
    excess = (1.0 if side == "stiff" else -1.0) * np.log(youngs / background)
    weights = np.maximum(excess, 0.0) * mesh.volumes * adjacent_elements(mesh, mask)
    center = weights @ mesh.centroids / weights.sum()
    return Inclusion.measure(mesh, youngs, mask, side, background, center)


def adjacent_elements(mesh: TetMesh, elements: Mask) -> Mask:
    """Return the elements and their vertex neighbours, unless that is the whole body."""
    nodes = np.zeros(mesh.n_points, dtype=bool)
    nodes[mesh.tets[elements]] = True
    near = nodes[mesh.tets].any(axis=1)
    return elements if near.all() else near


def _log_contrast(lump: Inclusion) -> float:
    return abs(float(np.log(lump.contrast)))

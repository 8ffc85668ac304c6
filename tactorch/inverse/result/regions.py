"""Lumps of an element map: connected parts of its segmentation (`tactorch.metrics.segment`)."""

from collections.abc import Sequence

import numpy as np
from scipy.special import ndtr, ndtri

from tactorch.errors import ConfigError
from tactorch.inverse.posterior.gaussian import GaussianPosterior
from tactorch.inverse.result.lump import TAIL, Confidence, Lump, measure_depth
from tactorch.mesh import TetMesh
from tactorch.metrics import Inclusion
from tactorch.metrics.segment import (
    Field,
    Mask,
    Side,
    check_field,
    connected_parts,
    segment,
    volume_mean,
    weighted_median,
)
from tactorch.recording import Press

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


def build_lump(
    mesh: TetMesh,
    presses: Sequence[Press],
    lump: Inclusion,
    posterior: GaussianPosterior | None = None,
) -> Lump:
    """Measure size, depth and confidence of an inclusion."""
    # The size is that of the ellipsoid with the second moments of the elements. Their bounding box
    # would be too large: it holds corners far from the lump.
    offsets = mesh.centroids - lump.center_mm
    within = np.ptp(mesh.points[mesh.tets], axis=1) ** 2 / 20.0  # approximate moment of an element
    size = 2.0 * np.sqrt(5.0 * volume_mean(mesh, offsets**2 + within, lump.elements))
    depth = measure_depth(mesh, presses, lump.center_mm, lump.elements)
    confidence = None if posterior is None else compute_confidence(mesh, lump, posterior)
    return Lump(lump, size, depth, confidence)


def compute_confidence(
    mesh: TetMesh, lump: Inclusion, posterior: GaussianPosterior, *, draws: int = 400, seed: int = 0
) -> Confidence:
    """Estimate the confidence of a lump of the posterior's map from samples of the posterior."""
    rng = np.random.default_rng(seed)
    x = np.clip(posterior.sample(rng, draws), *posterior.parameterization.limits)
    log_youngs = np.log(np.array([posterior.parameterization.youngs(row) for row in x]))
    near, sign = adjacent_elements(mesh, lump.elements), 1.0 if lump.side == "stiff" else -1.0
    background = volume_mean(mesh, log_youngs.T, ~near)
    # The contrast is that of the map; the samples' geometric means give its relative uncertainty.
    contrast = np.log(lump.contrast)
    deviation = (volume_mean(mesh, log_youngs.T, lump.elements) - background).std()
    low, high = np.exp(contrast + deviation * ndtri([TAIL, 1.0 - TAIL]))
    probability = ndtr(sign * contrast / deviation) if deviation > 0 else 1.0
    # Centres are weighted by the excess over the background.
    excess = np.maximum(sign * (log_youngs - background[:, None]), 0.0) * (mesh.volumes * near)
    centers = excess @ mesh.centroids / np.maximum(excess.sum(axis=1, keepdims=True), 1e-300)
    return Confidence(float(probability), (float(low), float(high)), centers.std(axis=0))

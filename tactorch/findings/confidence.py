"""Confidence of a lump by maps drawn from the posterior."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import ndtr

from tactorch.findings.lumps import adjacent_elements
from tactorch.mesh import TetMesh
from tactorch.metrics import Inclusion
from tactorch.metrics.segment import Side
from tactorch.uncertainty import GaussianPosterior

_TAIL = 0.05  # probability outside a 90 % interval, on either side


@dataclass(frozen=True, eq=False)
class Confidence:
    """Probability and intervals of a lump.

    They account for the stated noise and the prior, but not for model errors. The lump was
    selected as the most conspicuous one, so its probability is optimistic.

    Attributes:
        probability: Probability that the lump is stiffer (or softer) than its surroundings.
        contrast: 90 % interval of the ratio of the moduli's geometric means.
        center_deviation_mm: Standard deviation of the centre along x, y and z, (3,), mm.
    """

    probability: float
    contrast: tuple[float, float]
    center_deviation_mm: Float[np.ndarray, "3"]

    def at_least(self, side: Side) -> float:
        """Return the 95 % lower bound of the contrast as a ratio above 1.

        An upper bound is not given: total variation shrinks contrasts, so that the true one is
        often larger.
        """
        return self.contrast[0] if side == "stiff" else 1.0 / self.contrast[1]


def compute_confidence(
    mesh: TetMesh,
    lump: Inclusion,
    posterior: GaussianPosterior,
    *,
    draws: int = 400,
    seed: int = 0,
) -> Confidence:
    """Estimate the confidence of a lump from posterior samples.

    Args:
        mesh: Mesh of the map.
        lump: Lump of the posterior's map.
        posterior: Posterior, see `tactorch.uncertainty.compute_posterior`.
        draws: Number of samples.
        seed: Seed of the samples.

    Returns:
        Probability and intervals.
    """
    rng = np.random.default_rng(seed)
    x = np.clip(posterior.sample(rng, draws), *posterior.parameterization.limits)
    log_youngs = np.log(np.array([posterior.parameterization.youngs(row) for row in x]))
    sign = 1.0 if lump.side == "stiff" else -1.0
    inside, near = lump.elements, adjacent_elements(mesh, lump.elements)
    contrasts = _mean(mesh, log_youngs, inside) - _mean(mesh, log_youngs, ~near)
    ends = np.exp(np.quantile(contrasts, [_TAIL, 1.0 - _TAIL]))
    deviation = float(contrasts.std())
    probability = ndtr(sign * float(contrasts.mean()) / deviation) if deviation > 0 else 1.0
    return Confidence(
        probability=float(probability),
        contrast=(float(ends[0]), float(ends[1])),
        center_deviation_mm=_centers(mesh, sign * log_youngs, near).std(axis=0),
    )


def _mean(
    mesh: TetMesh, values: Float[np.ndarray, "n m"], mask: Bool[np.ndarray, " m"]
) -> Float[np.ndarray, " n"]:
    """Mean of each row over the volume of some elements."""
    weights = mesh.volumes * mask
    return values @ weights / weights.sum()


def _centers(
    mesh: TetMesh, signed: Float[np.ndarray, "n m"], near: Bool[np.ndarray, " m"]
) -> Float[np.ndarray, "n 3"]:
    """Centroids of lump and adjacent elements, weighted by the excess over the background."""
    background = _mean(mesh, signed, ~near)[:, None]
    excess = np.maximum(signed - background, 0.0) * (mesh.volumes * near)
    total = excess.sum(axis=1, keepdims=True)
    return excess @ mesh.centroids / np.maximum(total, 1e-300)

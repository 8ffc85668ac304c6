"""How sure a lump is, by maps drawn from the posterior of the moduli."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import ndtr

from tactorch.findings.lumps import around
from tactorch.mesh import TetMesh
from tactorch.metrics import Inclusion
from tactorch.metrics.segment import Side
from tactorch.uncertainty import GaussianPosterior

#: Draws, and what the ends of a 90 % interval leave out on either side.
DRAWS, _TAIL = 400, 0.05


@dataclass(frozen=True, eq=False)
class Confidence:
    """What the posterior says of a lump.

    It knows the noise that is stated and the prior, and nothing of what is wrong with the model;
    and the lump was looked for, so that the strongest of many chance ones seems surer than it is.

    Attributes:
        probability: That the lump is stiffer (or softer) than what surrounds it, 0 to 1.
        contrast: Least and largest ratio of the moduli that 90 % of the draws hold; each is that
            of the geometric means over the volumes.
        center_deviation_mm: Standard deviation of the centre along x, y and z, (3,), mm.
    """

    probability: float
    contrast: tuple[float, float]
    center_deviation_mm: Float[np.ndarray, "3"]

    def at_least(self, side: Side) -> float:
        """Return how many times as stiff (or as soft) the lump is at least, with 95 %.

        The upper end is not to be told like that: total variation draws a lump towards what
        surrounds it, so that the true contrast is often beyond.
        """
        return self.contrast[0] if side == "stiff" else 1.0 / self.contrast[1]


def confidence_of(
    mesh: TetMesh,
    lump: Inclusion,
    posterior: GaussianPosterior,
    *,
    draws: int = DRAWS,
    seed: int = 0,
) -> Confidence:
    """Tell how sure a lump is.

    Args:
        mesh: The body.
        lump: Part of the map that the posterior belongs to.
        posterior: As `tactorch.uncertainty.posterior_of` returns it.
        draws: Maps drawn.
        seed: Of the draws.
    """
    rng = np.random.default_rng(seed)
    x = np.clip(posterior.sample(rng, draws), *posterior.parameterization.limits)
    youngs = np.log(np.array([posterior.parameterization.youngs(row) for row in x]))
    sign = 1.0 if lump.side == "stiff" else -1.0
    inside, near = lump.elements, around(mesh, lump.elements)
    logs = _mean(mesh, youngs, inside) - _mean(mesh, youngs, ~near)
    ends = np.exp(np.quantile(logs, [_TAIL, 1.0 - _TAIL]))
    spread = float(logs.std())
    chance = float(ndtr(sign * float(logs.mean()) / spread)) if spread > 0 else 1.0
    return Confidence(
        probability=chance,
        contrast=(float(ends[0]), float(ends[1])),
        center_deviation_mm=_centers(mesh, sign * youngs, near).std(axis=0),
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
    """Centroid of what stands out, by how far it does, within the lump and what touches it."""
    background = _mean(mesh, signed, ~near)[:, None]
    excess = np.maximum(signed - background, 0.0) * (mesh.volumes * near)
    total = excess.sum(axis=1, keepdims=True)
    return excess @ mesh.centroids / np.maximum(total, 1e-300)

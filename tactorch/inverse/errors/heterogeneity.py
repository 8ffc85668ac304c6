"""Heterogeneity of the object: variations of Young's modulus that are no inclusion.

The logarithm of the modulus is a Gaussian process of the position, whose effect on the data is
linearised about a uniform body. It is a sum of cosines over the bounding box, which are those of
Laplace's operator, with the spectrum of a Gaussian covariance (A. Solin and S. Särkkä, "Hilbert
space methods for reduced-rank Gaussian process regression", Statistics and Computing 30 (2020),
419-446). Its deviation is found by the evidence, so that an inclusion has to explain the presses
better than it does.
"""

import numpy as np
from jaxtyping import Float

from tactorch.inverse.errors.base import ErrorSource, MeasuredPresses
from tactorch.mesh import TetMesh

_LENGTH = 0.25  # correlation length over the size of the body, the side of a cube of its volume
_LEAST_SHARE = 1e-3  # of the variance of a cosine, over that of the longest one
_MAX_WAVES = 8  # half waves along an axis


class Heterogeneity(ErrorSource):
    """Smooth variations of the logarithm of Young's modulus, in its unit."""

    name, elements, is_general = "heterogeneity", "linear", True
    proposal, levels = "a modulus that varies by {:.0%}", (0.02, 0.05, 0.1, 0.2)
    note = (
        "Young's modulus varies by about {:.0%} within the object, without a form that the presses "
        "resolve; the intervals of the lumps account for it."
    )

    def least(self, presses: MeasuredPresses) -> float | None:
        """Return zero, or None where the effect of the modulus is not known."""
        return None if presses.log_rates is None else 0.0

    def patterns(self, presses: MeasuredPresses) -> Float[np.ndarray, "data k"]:
        assert presses.log_rates is not None
        modes = _modes(presses.problem.recording.mesh).astype(presses.log_rates.dtype)
        return presses.problem.data.scale[:, None] * (presses.log_rates @ modes).astype(float)


def _modes(mesh: TetMesh) -> Float[np.ndarray, "elements k"]:
    """Return cosines at the centroids of elements, whose squares have a mean sum of one."""
    low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
    length = _LENGTH * np.cbrt(mesh.volumes.sum())
    waves = np.array(list(np.ndindex(*[_MAX_WAVES] * 3)))[1:]
    variances = np.exp(-0.5 * ((np.pi * length / (high - low) * waves) ** 2).sum(axis=1))
    kept = variances > _LEAST_SHARE * variances.max()
    phases = np.pi * (mesh.centroids - low) / (high - low)
    cosines = np.cos(phases[:, None] * waves[kept]).prod(axis=2) * np.sqrt(variances[kept])
    return cosines / np.sqrt(np.average((cosines**2).sum(axis=1), weights=mesh.volumes))

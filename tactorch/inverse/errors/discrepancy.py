"""Discrepancy of the model: displacements that neither the object nor another error explains.

The shape and depth of a body, its supports and Poisson's ratio are taken for exact. What they
change of the displacements at a contact is smooth, and looks like structure inside the body. As in
M. C. Kennedy and A. O'Hagan, "Bayesian calibration of computer models", J. R. Stat. Soc. B 63
(2001), 425-464, it is a Gaussian process, here of the position on the contact. Its deviation is
found by the evidence, so that an inclusion has to explain the presses better than it does.
"""

import numpy as np
from jaxtyping import Float
from scipy.spatial.distance import cdist

from tactorch.inverse.errors.base import ContactMotion, MeasuredPresses
from tactorch.inverse.forward.palpation import is_palpation

# Correlation length over the root mean square distance of the observed points from their mean: half
# of the radius of a round contact. With a depth that is wrong by a tenth, twice as much has 30 more
# log-evidence, and leaves a step of 3 % with a gain of 35 instead of 13.
_LENGTH = 0.7
_LEAST_SHARE = 1e-4  # of the variance, of patterns that are left out


class Discrepancy(ContactMotion):
    """Smooth displacements of each contact, over the displacements observed there."""

    name, elements = "discrepancy", "linear"
    is_proportional, is_general = False, True
    proposal, levels = "a discrepancy of {:.2%}", (0.0025, 0.005, 0.01, 0.02, 0.04, 0.08)
    note = (
        "The presses differ from the best model by smooth displacements, about {:.1%} of those "
        "observed, for which it has no cause; the intervals of the lumps account for them. Check "
        "the shape and depth of the object, its supports and Poisson's ratio."
    )

    def least(self, presses: MeasuredPresses) -> float | None:
        """Return zero; a palpation has smooth errors of its forces instead."""
        return None if is_palpation(presses.problem.recording) else 0.0

    def fields(
        self, points: Float[np.ndarray, "data 3"], axes: Float[np.ndarray, "data 3"]
    ) -> Float[np.ndarray, "data k"]:
        """Return the principal patterns of a Gaussian process of each displacement."""
        patterns = smooth_patterns(points)
        return np.hstack([axes[:, k, None] * patterns for k in range(3)])


def smooth_patterns(points: Float[np.ndarray, "data d"]) -> Float[np.ndarray, "data k"]:
    """Return the principal patterns of a Gaussian process of unit deviation at points."""
    places, number = np.unique(points, axis=0, return_inverse=True)
    length = _LENGTH * np.sqrt(places.var(axis=0).sum())
    kernel = np.exp(-0.5 * (cdist(places, places) / max(length, 1e-12)) ** 2)
    variances, modes = np.linalg.eigh(kernel)
    kept = variances > _LEAST_SHARE * variances[-1]
    return np.asarray((modes[:, kept] * np.sqrt(variances[kept]))[number.ravel()])

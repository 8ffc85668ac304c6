"""Ellipsoids."""

import numpy as np
from jaxtyping import Float
from scipy.linalg import expm, expm_frechet

from tactorch.inverse.fields.family import (
    DISTORTIONS,
    Distances,
    Family,
    Samples,
    Slopes,
    Values,
    length,
)
from tactorch.inverse.fields.inclusion import Candidate, Cloud, Parameters


class EllipsoidFamily(Family):
    """Ellipsoids: centre, radius of the ball of the same volume, contrast and five distortions.

    The level at x is L = |A (x - c)| with A = exp(-S), and the distance to the boundary
    (L - 1) / |grad L|, to first order.
    """

    name = judged_as = "ellipsoid"
    noun, distortions, special = "an ellipsoid", tuple(DISTORTIONS), ("ball",)

    def values(
        self,
        center_mm: Float[np.ndarray, "3"],
        log_stretch: Float[np.ndarray, "3 3"],
        log_contrast: float,
    ) -> Values:
        """Return the parameters of the ellipsoid of a matrix S, see `log_stretch`."""
        log_radius, distortions = np.trace(log_stretch) / 3.0, np.tensordot(self.basis, log_stretch)
        return np.array([*center_mm, log_radius, log_contrast, *distortions])

    def birth(self, candidate: Candidate) -> Values | None:
        center, radius, log_contrast, _, half = candidate
        length_mm = float(np.linalg.norm(half))
        if not length_mm:
            return None
        along = half / length_mm
        stretch = np.log(radius) * np.eye(3)
        stretch += np.log(1.0 + length_mm / radius) * np.outer(along, along)
        return self.values(center, stretch, log_contrast)

    def like(self, cloud: Cloud) -> Values:
        deviations, axes = cloud.principal()
        logs = np.log(deviations / np.cbrt(deviations.prod()))
        stretch = cloud.log_radius * np.eye(3) + axes.T @ np.diag(logs) @ axes
        return self.values(cloud.center, stretch, cloud.log_contrast)

    def distance(self, own: Parameters, points: Samples) -> Distances:
        inverse = expm(-self.log_stretch(own))
        unit = (points - own.center) @ inverse
        level = length(unit)
        return (level - 1.0) * level / length(unit @ inverse)

    def least_distance(
        self, own: Parameters, points: Float[np.ndarray, "n 3"]
    ) -> Float[np.ndarray, " n"]:
        stretch = self.log_stretch(own)
        unit = (points - own.center) @ expm(-stretch)
        return (length(unit) - 1.0) * float(np.exp(np.linalg.eigvalsh(stretch)[0]))

    def distance_derivative(self, own: Parameters, points: Samples) -> tuple[Distances, Slopes]:
        offset, stretch = points - own.center, self.log_stretch(own)
        inverse = expm(-stretch)
        unit = offset @ inverse
        slope = unit @ inverse
        level, steepness = length(unit), length(slope)
        distance = (level - 1.0) * level / steepness
        by_level = (2.0 * level - 1.0) / steepness / level
        by_slope = -distance / steepness**2
        changes = [np.eye(3), *self.basis]
        inverses = [expm_frechet(-stretch, -change, compute_expm=False) for change in changes]
        units = [-row for row in inverse] + [offset @ change for change in inverses]
        slopes = [-row for row in inverse @ inverse] + [
            moved @ inverse + unit @ change
            for moved, change in zip(units[3:], inverses, strict=True)
        ]
        return distance, np.stack([
            by_level * (unit * moved).sum(axis=-1) + by_slope * (slope * turned).sum(axis=-1)
            for moved, turned in zip(units, slopes, strict=True)
        ])  # fmt: skip


ELLIPSOID = EllipsoidFamily()

"""Balls."""

import numpy as np

from tactorch.inverse.fields.family import Distances, Family, Samples, Slopes, Values, length
from tactorch.inverse.fields.inclusion import Candidate, Cloud, Parameters


class BallFamily(Family):
    """Balls: centre, radius and contrast."""

    name, noun, judged_as = "ball", "a ball", "ellipsoid"

    def birth(self, candidate: Candidate) -> Values | None:
        if candidate.half_mm.any():
            return None
        return np.array([
            *candidate.center_mm, np.log(candidate.radius_mm), candidate.log_contrast,
        ])  # fmt: skip

    def like(self, cloud: Cloud) -> Values:
        return np.array([*cloud.center, cloud.log_radius, cloud.log_contrast])

    def distance(self, own: Parameters, points: Samples) -> Distances:
        return length(points - own.center) - np.exp(own.log_radius)

    def distance_derivative(self, own: Parameters, points: Samples) -> tuple[Distances, Slopes]:
        offset, radius = points - own.center, float(np.exp(own.log_radius))
        away = length(offset)
        centers = -np.moveaxis(offset / away[..., None], -1, 0)
        return away - radius, np.concatenate([centers, np.full((1, *away.shape), -radius)])


BALL = BallFamily()

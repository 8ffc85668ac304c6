"""Balls."""

import numpy as np
from jaxtyping import Float

from tactorch.inverse.fields.family import Family, Samples, length
from tactorch.inverse.fields.inclusion import Parameters


class Ball(Family):
    """Balls: centre, radius and contrast."""

    name, noun, judged_as = "ball", "a ball", "ellipsoid"

    def birth(
        self,
        center_mm: Float[np.ndarray, "3"],
        radius_mm: float,
        log_contrast: float,
        half_mm: Float[np.ndarray, "3"],
    ) -> Float[np.ndarray, " parameters"] | None:
        if half_mm.any():
            return None
        return np.array([*center_mm, np.log(radius_mm), log_contrast])

    def distance(self, own: Parameters, points: Samples) -> Float[np.ndarray, "volumes samples"]:
        return length(points - own.center) - np.exp(own.log_radius)

    def distance_derivative(
        self, own: Parameters, points: Samples
    ) -> tuple[Float[np.ndarray, "volumes samples"], Float[np.ndarray, "k volumes samples"]]:
        offset, radius = points - own.center, float(np.exp(own.log_radius))
        away = length(offset)
        centers = -np.moveaxis(offset / away[..., None], -1, 0)
        return away - radius, np.concatenate([centers, np.full((1, *away.shape), -radius)])


BALL = Ball()

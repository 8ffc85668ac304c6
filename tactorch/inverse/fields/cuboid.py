"""Cuboids along the axes."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tactorch.inverse.fields.family import Distances, Family, Samples, Slopes
from tactorch.inverse.fields.inclusion import InclusionShape, Parameters
from tactorch.mesh import Box
from tactorch.mesh.shapes import distance_to_product


@dataclass(frozen=True)
class CuboidShape(InclusionShape):
    """A cuboid of one contrast."""

    unit, unit_volume = Box(size_mm=2.0), 6.0 / np.pi

    @property
    def half_size_mm(self) -> Float[np.ndarray, "3"]:
        """Half the size along x, y and z."""
        return np.asarray(np.abs(self.vectors).sum(axis=0))


class CuboidFamily(Family):
    """Cuboids along x, y and z: centre, radius of the ball of the same volume, contrast and ratios.

    A search tries none unless it starts from one (`tactorch.inverse.search.model.with_family`).
    """

    name = judged_as = "cuboid"
    noun, distortions = "a cuboid", ("x-y", "xy-z")
    shape_type, reach, curvature = CuboidShape, np.sqrt(3.0), 0.0

    def _excess(self, own: Parameters, points: Samples) -> tuple[np.ndarray, np.ndarray]:
        """Return by how much points are beyond the faces along each axis, and half the size."""
        logs = np.diag(self.log_stretch(own))
        half = np.exp(logs) / np.cbrt(self.shape_type.unit_volume)
        return np.abs(points - own.center) - half, half

    def distance(self, own: Parameters, points: Samples) -> Distances:
        excess, _ = self._excess(own, points)
        return distance_to_product(excess.reshape(-1, 3)).reshape(excess.shape[:-1])

    def distance_derivative(self, own: Parameters, points: Samples) -> tuple[Distances, Slopes]:
        excess, half = self._excess(own, points)
        distance = self.distance(own, points)
        outside, nearest = np.maximum(excess, 0.0), np.eye(3)[excess.argmax(axis=-1)]
        normals = np.where(distance[..., None] > 0.0, outside, nearest)
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        centers = -normals * np.sign(points - own.center)
        sizes = [np.ones(3), *np.diagonal(self.basis, axis1=1, axis2=2)]
        by_size = [-normals @ (half * change) for change in sizes]
        return distance, np.concatenate([np.moveaxis(centers, -1, 0), by_size])


CUBOID = CuboidFamily()

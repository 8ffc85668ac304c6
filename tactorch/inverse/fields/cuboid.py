"""Cuboids: blocks, bars and plates."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.linalg import expm_frechet
from scipy.spatial.transform import Rotation

from tactorch.inverse.fields.family import (
    VARIANCE,
    Distances,
    Family,
    Samples,
    Slopes,
    Values,
    Widths,
)
from tactorch.inverse.fields.inclusion import Cloud, InclusionShape, Parameters
from tactorch.inverse.fields.prior import ShapePrior
from tactorch.mesh import Box
from tactorch.mesh.shapes import distance_to_product

_RATIO, _TURN = 0.7, 1.0  # standard deviations of the logarithms of ratios, and of turns
_AT_EDGES = (2.0 * np.pi + 8.0) / 16.0
# Matrices of the cross products with x, y and z.
_CROSS = np.array([np.cross(np.eye(3), axis) for axis in np.eye(3)])


@dataclass(frozen=True)
class CuboidShape(InclusionShape):
    """A cuboid of one contrast."""

    unit, unit_volume = Box(size_mm=2.0), 6.0 / np.pi

    def distance(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Return the distance to the boundary (mm), negative inside."""
        half = np.array(self.semi_axes_mm)
        return distance_to_product(np.abs(self.relative(points)) * half - half)

    @property
    def form(self) -> str:
        """Noun for the form: a plate is less than half as thick as wide, a bar twice as long."""
        first, second, third = self.semi_axes_mm
        if third < 0.5 * second:
            return "plate"
        return "bar" if second < 0.5 * first else "block"

    @property
    def extents_mm(self) -> Float[np.ndarray, "2 3"]:
        """Lowest and highest coordinates, from the centre."""
        return np.outer([-1.0, 1.0], np.abs(self.vectors).sum(axis=0))

    @property
    def detail_mm(self) -> float:
        """Mean of half the smallest side and the radius, geometric."""
        return float(np.sqrt(self.semi_axes_mm[-1] * self.radius_mm))


class CuboidFamily(Family):
    """Cuboids: centre, radius of the ball of the same volume, contrast, two ratios and a turn.

    The turn is a rotation vector (rad), from sides along x, y and z.
    """

    name = judged_as = "cuboid"
    noun, distortions = "a cuboid", ("x-y", "xy-z", "turn x", "turn y", "turn z")
    shape_type = CuboidShape

    def scale(self, prior: ShapePrior) -> tuple[list[float], list[float]]:
        mean, deviation = super().scale(prior)
        return mean, [*deviation[:5], *[_RATIO] * 2, *[_TURN] * 3]

    def like(self, cloud: Cloud) -> Values:
        deviations, axes = cloud.principal()
        # Sides are numbered so that the turn is small.
        order = np.abs(axes).argmax(axis=1)
        order = order if len(set(order.tolist())) == 3 else np.arange(3)
        sides, turned = np.empty(3), np.empty((3, 3))
        sides[order], turned[order] = np.log(deviations / np.cbrt(deviations.prod())), axes
        turned *= np.sign(np.diag(turned))[:, None] + (np.diag(turned) == 0.0)[:, None]
        turned[2] *= np.linalg.det(turned)
        turn = Rotation.from_matrix(turned.T).as_rotvec()
        ratios = np.tensordot(self.basis, np.diag(sides))
        return np.array([*cloud.center, cloud.log_radius, cloud.log_contrast, *ratios, *turn])

    def shape(self, own: Parameters) -> InclusionShape:
        half, order = self._half(own), np.argsort(-self._half(own))
        axes = _rotation(own).T[order]
        return CuboidShape(
            tuple(own.center.tolist()),
            tuple(half[order].tolist()),
            tuple(tuple(row) for row in axes.tolist()),
            float(np.exp(own.log_contrast)),
        )

    def distance(self, own: Parameters, points: Samples) -> Distances:
        excess = np.abs((points - own.center) @ _rotation(own)) - self._half(own)
        return distance_to_product(excess.reshape(-1, 3)).reshape(excess.shape[:-1])

    def distance_derivative(self, own: Parameters, points: Samples) -> tuple[Distances, Slopes]:
        offsets, rotation, half = points - own.center, _rotation(own), self._half(own)
        along = offsets @ rotation
        excess = np.abs(along) - half
        distance = distance_to_product(excess.reshape(-1, 3)).reshape(excess.shape[:-1])
        outside, nearest = np.maximum(excess, 0.0), np.eye(3)[excess.argmax(axis=-1)]
        normals = np.where(distance[..., None] > 0.0, outside, nearest)
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        by_size = [-normals @ change for change in self._half_changes(half)]
        signed = normals * np.sign(along)
        matrix = np.tensordot(own.distortions[2:], _CROSS, 1)
        turns = [expm_frechet(matrix, cross, compute_expm=False) for cross in _CROSS]
        by_turn = [(signed * (offsets @ turn)).sum(axis=-1) for turn in turns]
        centers = np.moveaxis(-signed @ rotation.T, -1, 0)
        return distance, np.concatenate([centers, by_size, by_turn])

    def _shift(self, own: Parameters, width: Widths) -> Widths:
        return VARIANCE * width * width * _curvature(self._half(own))[0]

    def _shift_derivative(self, own: Parameters, width: Widths) -> Float[np.ndarray, "k volumes"]:
        half = self._half(own)
        by_half = _curvature(half)[1]
        by_size = [change @ by_half for change in self._half_changes(half)]
        slopes = np.concatenate([np.zeros(3), by_size, np.zeros(3)])
        return np.outer(slopes, VARIANCE * width * width)

    def _half_changes(self, half: Float[np.ndarray, "3"]) -> list[Float[np.ndarray, "3"]]:
        """Derivatives of half the sides by the log-radius and the ratios."""
        return [half, *(half * change for change in np.diagonal(self.basis, axis1=1, axis2=2))]

    def _half(self, own: Parameters) -> Float[np.ndarray, "3"]:
        """Half the length of the sides, mm."""
        return np.exp(np.diag(self.log_stretch(own))) / np.cbrt(self.shape_type.unit_volume)


def _curvature(half: Float[np.ndarray, "3"]) -> tuple[float, Float[np.ndarray, "3"]]:
    """Return the mean curvature of a cuboid of half these sides (1/mm), and its derivatives.

    The volumes within distances t of its boundary, outside and inside, are S t and (2 pi and 8) (a
    + b + c) t^2 to second order, with the surface S = 8 (ab + bc + ca) (Steiner's formula).
    """
    total, pairs = float(half.sum()), float(half @ np.roll(half, 1))
    slopes = 1.0 / pairs - total * (total - half) / pairs**2
    return _AT_EDGES * total / pairs, _AT_EDGES * slopes


def _rotation(own: Parameters) -> Float[np.ndarray, "3 3"]:
    """Return the matrix whose columns are the directions of the sides."""
    return Rotation.from_rotvec(own.distortions[2:]).as_matrix()


CUBOID = CuboidFamily()

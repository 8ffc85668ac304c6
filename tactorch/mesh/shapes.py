"""Solid shapes as signed distances: negative inside, zero on the surface, positive outside.

Distances are Euclidean and exact unless stated otherwise. Lengths in mm. Vectors are any three
numbers; they are stored as tuples, so that equal shapes compare equal.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from tactorch.errors import ConfigError
from tactorch.mesh.surfaces import TriangleSurface, half_circle, marching_cubes, revolve
from tactorch.mesh.values import (
    Checked,
    Corners,
    Points,
    Real,
    Vector,
    checked,
    positive,
    sizes,
    vector,
)

ORIGIN, UP = (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)
Distances = Float[np.ndarray, " n"]
Inside = Bool[np.ndarray, " n"]
# Corner b = 4 ix + 2 iy + iz.
_BOX_TRIANGLES = (
    (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
    (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3),
)  # fmt: skip


class Shape(Checked, ABC):
    """Base of solid shapes."""

    @abstractmethod
    def signed_distance(self, points: Points) -> Distances:
        """Return the distance of each point (n, 3) to the surface, mm, negative inside."""

    @abstractmethod
    def bounds(self) -> Corners:
        """Return the lowest and the highest corner of the bounding box, mm."""

    def contains(self, points: Points) -> Inside:
        """Return whether each point (n, 3) is inside or on the surface."""
        return self.signed_distance(points) <= 0.0

    def surface(self, segments: int = 48) -> TriangleSurface:
        """Return vertices (mm) and outward triangles of the closed surface.

        Boxes are exact; round shapes are polyhedra with vertices on the surface; surfaces of unions
        are computed by marching cubes with 64 cells along the longest side, which rounds edges.

        Args:
            segments: Number of sides of round shapes; a multiple of 4.
        """
        return marching_cubes(self.signed_distance, self.bounds(), str(self))


@dataclass(frozen=True)
class CenteredShape(Shape):
    """Base of shapes with a centre."""

    center_mm: Vector = checked(vector, ORIGIN)

    def _box(self, half: Float[np.ndarray, "3"]) -> Corners:
        """Box of half edge lengths around the centre."""
        return np.stack((np.array(self.center_mm) - half, np.array(self.center_mm) + half))


@dataclass(frozen=True)
class Sphere(CenteredShape):
    """Ball of centre `center_mm` and radius `radius_mm`."""

    radius_mm: Real = checked(positive, 1.0)

    def signed_distance(self, points: Points) -> Distances:
        return np.linalg.norm(points - np.array(self.center_mm), axis=1) - self.radius_mm

    def bounds(self) -> Corners:
        return self._box(np.full(3, self.radius_mm))

    def surface(self, segments: int = 48) -> TriangleSurface:
        return revolve(self.radius_mm * half_circle(segments), self.center_mm, UP, segments)


@dataclass(frozen=True)
class Box(CenteredShape):
    """Axis-aligned cuboid of centre `center_mm` and edge lengths `size_mm`, three or one."""

    size_mm: Vector | Real = checked(sizes, (1.0, 1.0, 1.0))

    def signed_distance(self, points: Points) -> Distances:
        excess = np.abs(points - np.array(self.center_mm)) - np.array(self.size_mm) / 2
        return distance_to_product(excess)

    def bounds(self) -> Corners:
        return self._box(np.array(self.size_mm) / 2)

    def surface(self, segments: int = 48) -> TriangleSurface:
        corners = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)])
        return self.bounds()[0] + corners * np.array(self.size_mm), np.array(_BOX_TRIANGLES)


@dataclass(frozen=True)
class Ellipsoid(CenteredShape):
    """Axis-aligned ellipsoid of centre `center_mm` and semi-axes `radii_mm`."""

    radii_mm: Vector = checked(sizes, (1.0, 1.0, 1.0))

    def signed_distance(self, points: Points) -> Distances:
        radii = np.array(self.radii_mm)
        offset = np.abs(points - np.array(self.center_mm))
        distance = np.linalg.norm(offset - _nearest_on_ellipsoid(offset, radii), axis=1)
        return np.where(self.contains(points), -distance, distance)

    def contains(self, points: Points) -> Inside:
        scaled = (points - np.array(self.center_mm)) / np.array(self.radii_mm)
        return np.square(scaled).sum(axis=1) <= 1.0

    def bounds(self) -> Corners:
        return self._box(np.array(self.radii_mm))

    def surface(self, segments: int = 48) -> TriangleSurface:
        vertices, triangles = Sphere().surface(segments)
        return vertices * np.array(self.radii_mm) + np.array(self.center_mm), triangles


def _shape(name: str, value: Any) -> Shape:
    if not isinstance(value, Shape):
        raise ConfigError(f"{name}={value!r} is not a shape; give one of tactorch.mesh.")
    return value


def _shapes(name: str, values: Any) -> tuple[Shape, ...]:
    shapes = tuple(_shape(f"{name}[{i}]", value) for i, value in enumerate(values))
    if not shapes:
        raise ConfigError(f"{name} is empty; give at least one shape.")
    return shapes


@dataclass(frozen=True)
class Union(Shape):
    """Union of the shapes in `parts`.

    The signed distance is exact outside; inside it is a lower bound in magnitude: the distance to
    the surface of the part that the point is deepest in.
    """

    parts: Sequence[Any] = checked(_shapes)

    def signed_distance(self, points: Points) -> Distances:
        return np.min([part.signed_distance(points) for part in self.parts], axis=0)

    def contains(self, points: Points) -> Inside:
        return np.any([part.contains(points) for part in self.parts], axis=0)

    def bounds(self) -> Corners:
        boxes = np.array([part.bounds() for part in self.parts])
        return np.stack((boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)))


@dataclass(frozen=True)
class Rotated(Shape):
    """Shape rotated about the centre of its bounding box; `bounds` may be larger than needed.

    Attributes:
        of: Shape to rotate.
        turn_deg: Rotation vector: direction of the axis, times the angle in degrees.
    """

    of: Any = checked(_shape)
    turn_deg: Vector = checked(vector, ORIGIN)

    def signed_distance(self, points: Points) -> Distances:
        return self.of.signed_distance(self._rotate(points, self.matrix()))

    def contains(self, points: Points) -> Inside:
        return self.of.contains(self._rotate(points, self.matrix()))

    def bounds(self) -> Corners:
        low, high = self.of.bounds()
        half = np.abs(self.matrix()) @ (high - low) / 2
        return np.stack(((low + high) / 2 - half, (low + high) / 2 + half))

    def surface(self, segments: int = 48) -> TriangleSurface:
        vertices, triangles = self.of.surface(segments)
        return self._rotate(vertices, self.matrix().T), triangles

    def matrix(self) -> Float[np.ndarray, "3 3"]:
        """Return the rotation matrix."""
        return Rotation.from_rotvec(np.array(self.turn_deg), degrees=True).as_matrix()

    def _rotate(self, points: Points, matrix: Float[np.ndarray, "3 3"]) -> Points:
        center = self.of.bounds().mean(axis=0)
        return (points - center) @ matrix + center


def _nearest_on_ellipsoid(offset: Points, radii: Float[np.ndarray, "3"]) -> Points:
    """Return the nearest surface point of points in the first octant.

    It is r_i^2 y_i / (s + r_i^2 - r_min^2) where s > 0 solves sum (r_i y_i / (...))^2 = 1
    (D. Eberly, "Distance from a Point to an Ellipse, an Ellipsoid, or a Hyperellipsoid"). The sum
    is decreasing and convex in s, so Newton's method from the left never overshoots.
    """
    # A point on a symmetry plane may have nearest points on both sides: shift it to one side.
    y = np.maximum(offset, 1e-12 * radii)
    gap = radii**2 - radii.min() ** 2
    s = np.max(radii * y - gap, axis=1)
    active = np.arange(len(s))
    for _ in range(200):
        denominators = s[active, None] + gap
        squares = np.square(radii * y[active] / denominators)
        slope = -2.0 * (squares / denominators).sum(axis=1)
        step = (1.0 - squares.sum(axis=1)) / slope
        s[active] += step
        active = active[np.abs(step) > 1e-14 * s[active]]
        if not active.size:
            break
    return radii**2 * y / (s[:, None] + gap)


def distance_to_product(excess: Float[np.ndarray, "n d"]) -> Distances:
    """Return the signed distance to a product of intervals, from each coordinate's excess."""
    outside = np.linalg.norm(np.maximum(excess, 0.0), axis=1)
    return outside + np.minimum(excess.max(axis=1), 0.0)

"""Solid shapes as signed distances: negative inside, zero on the surface, positive outside.

Distances are exact (Euclidean), so they serve as well to say how far a point is from an inclusion
as whether it is inside. Lengths in mm. Vectors may be given as any three numbers, and are kept as
tuples, so that equal shapes compare equal.
"""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float

from tactorch.mesh.values import Real, Vector, positive, sizes, unit_vector, vector


@runtime_checkable
class Shape(Protocol):
    """What a solid shape can answer."""

    def signed_distance(self, points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        """Return the distance of each point to the surface, mm, negative inside."""
        ...

    def contains(self, points: Float[np.ndarray, "k 3"]) -> Bool[np.ndarray, " k"]:
        """Return whether each point is inside or on the surface."""
        ...

    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Return the lowest and the highest corner of the bounding box, mm."""
        ...


class Contains:
    """For shapes: inside is where the distance is not positive."""

    def contains(self: Shape, points: Float[np.ndarray, "k 3"]) -> Bool[np.ndarray, " k"]:
        """Return whether each point is inside or on the surface."""
        return self.signed_distance(points) <= 0.0


@dataclass(frozen=True)
class Sphere(Contains):
    """A ball: `center_mm`, `radius_mm`."""

    center_mm: Vector = (0.0, 0.0, 0.0)
    radius_mm: Real = 1.0

    def __post_init__(self) -> None:
        store(self, center_mm=vector("center_mm", self.center_mm))
        store(self, radius_mm=positive("radius_mm", self.radius_mm))

    def signed_distance(self, points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        """Return the distance of each point to the surface, mm, negative inside."""
        return np.linalg.norm(points - np.array(self.center_mm), axis=1) - self.radius_mm

    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Return the lowest and the highest corner of the bounding box, mm."""
        return _around(self.center_mm, np.full(3, self.radius_mm))


@dataclass(frozen=True)
class Box(Contains):
    """A cuboid along the axes: `center_mm` and full edge lengths `size_mm`."""

    center_mm: Vector = (0.0, 0.0, 0.0)
    size_mm: Vector = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        store(self, center_mm=vector("center_mm", self.center_mm))
        store(self, size_mm=sizes("size_mm", self.size_mm))

    def signed_distance(self, points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        """Return the distance of each point to the surface, mm, negative inside."""
        beyond = np.abs(points - np.array(self.center_mm)) - np.array(self.size_mm) / 2
        return _outside_or_nearest(beyond)

    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Return the lowest and the highest corner of the bounding box, mm."""
        return _around(self.center_mm, np.array(self.size_mm) / 2)


@dataclass(frozen=True)
class Cylinder(Contains):
    """A solid cylinder: `center_mm` at mid-height, `radius_mm`, full `height_mm`, `axis`."""

    center_mm: Vector = (0.0, 0.0, 0.0)
    radius_mm: Real = 1.0
    height_mm: Real = 1.0
    axis: Vector = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        store(self, center_mm=vector("center_mm", self.center_mm))
        store(self, radius_mm=positive("radius_mm", self.radius_mm))
        store(self, height_mm=positive("height_mm", self.height_mm))
        store(self, axis=unit_vector("axis", self.axis))

    def signed_distance(self, points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        """Return the distance of each point to the surface, mm, negative inside."""
        axis = np.array(self.axis)
        offset = points - np.array(self.center_mm)
        along = offset @ axis
        across = np.linalg.norm(offset - along[:, None] * axis, axis=1)
        beyond = np.column_stack((across - self.radius_mm, np.abs(along) - self.height_mm / 2))
        return _outside_or_nearest(beyond)

    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Return the lowest and the highest corner of the bounding box, mm."""
        axis = np.array(self.axis)
        disc = self.radius_mm * np.sqrt(np.maximum(0.0, 1.0 - axis**2))
        return _around(self.center_mm, np.abs(axis) * self.height_mm / 2 + disc)


@dataclass(frozen=True)
class Ellipsoid(Contains):
    """An ellipsoid along the axes: `center_mm` and semi-axes `radii_mm`."""

    center_mm: Vector = (0.0, 0.0, 0.0)
    radii_mm: Vector = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        store(self, center_mm=vector("center_mm", self.center_mm))
        store(self, radii_mm=sizes("radii_mm", self.radii_mm))

    def signed_distance(self, points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        """Return the distance of each point to the surface, mm, negative inside."""
        radii = np.array(self.radii_mm)
        offset = np.abs(points - np.array(self.center_mm))
        distance = np.linalg.norm(offset - _nearest_on_ellipsoid(offset, radii), axis=1)
        return np.where(self.contains(points), -distance, distance)

    def contains(self, points: Float[np.ndarray, "k 3"]) -> Bool[np.ndarray, " k"]:
        """Return whether each point is inside or on the surface, without finding its distance."""
        scaled = (points - np.array(self.center_mm)) / np.array(self.radii_mm)
        return np.square(scaled).sum(axis=1) <= 1.0

    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Return the lowest and the highest corner of the bounding box, mm."""
        return _around(self.center_mm, np.array(self.radii_mm))


def _nearest_on_ellipsoid(
    offset: Float[np.ndarray, "k 3"], radii: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "k 3"]:
    """Return the nearest surface point of points in the first octant.

    It is r_i^2 y_i / (s + r_i^2 - r_min^2) where s > 0 solves sum (r_i y_i / (...))^2 = 1
    (D. Eberly, "Distance from a Point to an Ellipse, an Ellipsoid, or a Hyperellipsoid"). The sum
    falls and is convex in s, so Newton from the left never overshoots.
    """
    # A point on a symmetry plane may have its nearest points off it: nudge it to one side.
    y = np.maximum(offset, 1e-12 * radii)
    gap = radii**2 - radii.min() ** 2
    s = np.max(radii * y - gap, axis=1)
    going = np.arange(len(s))
    for _ in range(200):
        denominators = s[going, None] + gap
        squares = np.square(radii * y[going] / denominators)
        slope = -2.0 * (squares / denominators).sum(axis=1)
        step = (1.0 - squares.sum(axis=1)) / slope
        s[going] += step
        going = going[np.abs(step) > 1e-14 * s[going]]
        if not going.size:
            break
    return radii**2 * y / (s[:, None] + gap)


def _outside_or_nearest(beyond: Float[np.ndarray, "k d"]) -> Float[np.ndarray, " k"]:
    """Distance to a product of intervals, from how far each coordinate is beyond its own."""
    outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
    return outside + np.minimum(beyond.max(axis=1), 0.0)


def _around(center: Vector, half: Float[np.ndarray, "3"]) -> Float[np.ndarray, "2 3"]:
    return np.stack((np.array(center) - half, np.array(center) + half))


def store(shape: object, **fields: object) -> None:
    """Set fields of a frozen shape, once checked."""
    for name, value in fields.items():
        object.__setattr__(shape, name, value)

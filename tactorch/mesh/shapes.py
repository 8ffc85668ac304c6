"""Solid shapes as signed distances: negative inside, zero on the surface, positive outside.

Distances are Euclidean and exact unless stated otherwise. Lengths in mm. Vectors are any three
numbers; they are stored as tuples, so that equal shapes compare equal.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from tactorch.errors import ConfigError
from tactorch.mesh.values import (
    Checked,
    Real,
    Vector,
    checked,
    positive,
    sizes,
    unit_vector,
    vector,
)


@runtime_checkable
class Shape(Protocol):
    """Interface of solid shapes."""

    def signed_distance(self, points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        """Return the distance of each point to the surface, mm, negative inside."""
        ...

    def contains(self, points: Float[np.ndarray, "k 3"]) -> Bool[np.ndarray, " k"]:
        """Return whether each point is inside or on the surface."""
        ...

    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Return the lowest and the highest corner of the bounding box, mm."""
        ...


class Solid(Checked):
    """Base of shapes whose inside is where the signed distance is not positive."""

    def contains(self: Shape, points: Float[np.ndarray, "k 3"]) -> Bool[np.ndarray, " k"]:
        """Return whether each point is inside or on the surface."""
        return self.signed_distance(points) <= 0.0


@dataclass(frozen=True)
class Sphere(Solid):
    """Ball of centre `center_mm` and radius `radius_mm`."""

    center_mm: Vector = checked(vector, (0.0, 0.0, 0.0))
    radius_mm: Real = checked(positive, 1.0)

    def signed_distance(self, points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        """Return the distance of each point to the surface, mm, negative inside."""
        return np.linalg.norm(points - np.array(self.center_mm), axis=1) - self.radius_mm

    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Return the lowest and the highest corner of the bounding box, mm."""
        return _around(self.center_mm, np.full(3, self.radius_mm))


@dataclass(frozen=True)
class Box(Solid):
    """Axis-aligned cuboid of centre `center_mm` and edge lengths `size_mm`."""

    center_mm: Vector = checked(vector, (0.0, 0.0, 0.0))
    size_mm: Vector = checked(sizes, (1.0, 1.0, 1.0))

    def signed_distance(self, points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        """Return the distance of each point to the surface, mm, negative inside."""
        beyond = np.abs(points - np.array(self.center_mm)) - np.array(self.size_mm) / 2
        return _outside_or_nearest(beyond)

    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Return the lowest and the highest corner of the bounding box, mm."""
        return _around(self.center_mm, np.array(self.size_mm) / 2)


@dataclass(frozen=True)
class Cylinder(Solid):
    """Solid cylinder: `center_mm` at mid-height, `radius_mm`, full `height_mm`, `axis`."""

    center_mm: Vector = checked(vector, (0.0, 0.0, 0.0))
    radius_mm: Real = checked(positive, 1.0)
    height_mm: Real = checked(positive, 1.0)
    axis: Vector = checked(unit_vector, (0.0, 0.0, 1.0))

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
class Ellipsoid(Solid):
    """Axis-aligned ellipsoid of centre `center_mm` and semi-axes `radii_mm`."""

    center_mm: Vector = checked(vector, (0.0, 0.0, 0.0))
    radii_mm: Vector = checked(sizes, (1.0, 1.0, 1.0))

    def signed_distance(self, points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        """Return the distance of each point to the surface, mm, negative inside."""
        radii = np.array(self.radii_mm)
        offset = np.abs(points - np.array(self.center_mm))
        distance = np.linalg.norm(offset - _nearest_on_ellipsoid(offset, radii), axis=1)
        return np.where(self.contains(points), -distance, distance)

    def contains(self, points: Float[np.ndarray, "k 3"]) -> Bool[np.ndarray, " k"]:
        """Return whether each point is inside or on the surface."""
        scaled = (points - np.array(self.center_mm)) / np.array(self.radii_mm)
        return np.square(scaled).sum(axis=1) <= 1.0

    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Return the lowest and the highest corner of the bounding box, mm."""
        return _around(self.center_mm, np.array(self.radii_mm))


@dataclass(frozen=True)
class Union:
    """Union of the shapes in `parts`.

    The signed distance is exact outside; inside it is a lower bound in magnitude: the distance to
    the surface of the part that the point is deepest in.
    """

    parts: Sequence[Any]  # shapes; not annotated as such, so that messages give the index

    def __post_init__(self) -> None:
        parts = tuple(self.parts)
        if not parts:
            raise ConfigError("parts is empty; give at least one shape.")
        for i, part in enumerate(parts):
            _check_shape(f"parts[{i}]", part)
        object.__setattr__(self, "parts", parts)

    def signed_distance(self, points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        """Return the distance of each point to the surface, mm, negative inside."""
        return np.min([part.signed_distance(points) for part in self.parts], axis=0)

    def contains(self, points: Float[np.ndarray, "k 3"]) -> Bool[np.ndarray, " k"]:
        """Return whether each point is inside or on the surface."""
        return np.any([part.contains(points) for part in self.parts], axis=0)

    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Return the lowest and the highest corner of the bounding box, mm."""
        boxes = np.array([part.bounds() for part in self.parts])
        return np.stack((boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)))


@dataclass(frozen=True)
class Rotated(Checked):
    """Shape rotated about the centre of its bounding box.

    Attributes:
        of: Shape to rotate.
        turn_deg: Rotation vector: direction of the axis, times the angle in degrees.
    """

    of: Shape
    turn_deg: Vector = checked(vector, (0.0, 0.0, 0.0))

    def __post_init__(self) -> None:
        _check_shape("of", self.of)
        super().__post_init__()

    @property
    def rotation(self) -> Float[np.ndarray, "3 3"]:
        """Rotation matrix, applied to column vectors."""
        return Rotation.from_rotvec(np.array(self.turn_deg), degrees=True).as_matrix()

    def rotate(self, points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "k 3"]:
        """Rotate points of the shape, mm."""
        center = self.of.bounds().mean(axis=0)
        return (points - center) @ self.rotation.T + center

    def signed_distance(self, points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        """Return the distance of each point to the surface, mm, negative inside."""
        return self.of.signed_distance(self._rotate_back(points))

    def contains(self, points: Float[np.ndarray, "k 3"]) -> Bool[np.ndarray, " k"]:
        """Return whether each point is inside or on the surface."""
        return self.of.contains(self._rotate_back(points))

    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Return an axis-aligned box that contains the rotated bounding box, mm."""
        low, high = self.of.bounds()
        half = np.abs(self.rotation) @ (high - low) / 2
        return np.stack(((low + high) / 2 - half, (low + high) / 2 + half))

    def _rotate_back(self, points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "k 3"]:
        center = self.of.bounds().mean(axis=0)
        return (points - center) @ self.rotation + center


def _nearest_on_ellipsoid(
    offset: Float[np.ndarray, "k 3"], radii: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "k 3"]:
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


def _outside_or_nearest(beyond: Float[np.ndarray, "k d"]) -> Float[np.ndarray, " k"]:
    """Signed distance to a product of intervals, from each coordinate's excess over its own."""
    outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
    return outside + np.minimum(beyond.max(axis=1), 0.0)


def _around(center: Vector, half: Float[np.ndarray, "3"]) -> Float[np.ndarray, "2 3"]:
    return np.stack((np.array(center) - half, np.array(center) + half))


def _check_shape(name: str, shape: object) -> None:
    if not isinstance(shape, Shape):
        raise ConfigError(f"{name}={shape!r} is not a shape; give one of tactorch.mesh.")

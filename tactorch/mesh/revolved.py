"""Solids of revolution as signed distances. Lengths in mm.

The nearest point of the surface is in the same half-plane through the axis, so the distance to the
solid equals the distance to its profile in that half-plane and is exact.
"""

from abc import abstractmethod
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.mesh.shapes import UP, CenteredShape, Distances, distance_to_product
from tactorch.mesh.surfaces import Profile, TriangleSurface, coarsen, revolve, torus
from tactorch.mesh.values import Corners, Points, Real, Rows, Vector, checked, positive, unit_vector

_CURVE_SEGMENTS = 96


def _top_radius(name: str, value: Real) -> float:
    if not (np.isfinite(value) and value >= 0):
        raise ConfigError(f"{name}={value!r} must be a radius, or 0 for an apex.")
    return float(value)


def _outline(name: str, value: Rows) -> tuple[tuple[float, ...], ...]:
    points = np.asarray(value, dtype=np.float64)
    if points.ndim != 2 or points.shape[1:] != (2,) or not np.isfinite(points).all():
        raise ConfigError(f"{name} must be points (radius, height), finite, in mm.")
    if len(points) < 3 or points[[0, -1], 0].any() or not (points[1:-1, 0] > 0).all():
        raise ConfigError(
            f"{name} must begin and end on the axis (radius 0) and be off it between."
        )
    if not np.diff(points, axis=0).any(axis=1).all():
        raise ConfigError(f"{name} repeats a point; leave one out.")
    return tuple(tuple(map(float, point)) for point in points)


class _Axial(CenteredShape):
    """Shape around the line through `center_mm` along `axis`."""

    axis: Vector

    def _in_half_plane(self, points: Points) -> Float[np.ndarray, "n 2"]:
        """Each point's distance from the axis and its height along it."""
        axis = np.array(self.axis)
        offset = points - np.array(self.center_mm)
        along = offset @ axis
        return np.column_stack((np.linalg.norm(offset - along[:, None] * axis, axis=1), along))

    def _disc(self) -> Float[np.ndarray, "3"]:
        """Half edge lengths of the bounding box of a disc of radius 1 across the axis."""
        return np.sqrt(np.maximum(0.0, 1.0 - np.array(self.axis) ** 2))


class _Revolved(_Axial):
    @abstractmethod
    def _profile(self) -> Profile: ...

    def signed_distance(self, points: Points) -> Distances:
        return _polygon_distance(self._in_half_plane(points), self._profile())

    def bounds(self) -> Corners:
        profile = self._profile()
        along, across = np.outer(profile[:, 1], self.axis), np.outer(profile[:, 0], self._disc())
        low, high = (along - across).min(axis=0), (along + across).max(axis=0)
        return np.array(self.center_mm) + np.stack((low, high))

    def surface(self, segments: int = 48) -> TriangleSurface:
        return revolve(coarsen(self._profile(), segments), self.center_mm, self.axis, segments)


@dataclass(frozen=True)
class Cylinder(_Revolved):
    """Solid cylinder: `center_mm` at mid-height, `radius_mm`, full `height_mm`, `axis`."""

    radius_mm: Real = checked(positive, 1.0)
    height_mm: Real = checked(positive, 1.0)
    axis: Vector = checked(unit_vector, UP)

    def signed_distance(self, points: Points) -> Distances:
        across, along = self._in_half_plane(points).T
        half = self.height_mm / 2
        return distance_to_product(np.column_stack((across - self.radius_mm, np.abs(along) - half)))

    def _profile(self) -> Profile:
        radius, half = self.radius_mm, self.height_mm / 2
        return np.array([(0.0, -half), (radius, -half), (radius, half), (0.0, half)])


@dataclass(frozen=True)
class Torus(_Axial):
    """Torus: `center_mm`, major radius `radius_mm`, minor radius `tube_mm`, `axis`."""

    radius_mm: Real = checked(positive, 1.0)
    tube_mm: Real = checked(positive, 0.3)
    axis: Vector = checked(unit_vector, UP)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.tube_mm >= self.radius_mm:
            raise ConfigError(
                f"tube_mm={self.tube_mm:g} must be smaller than radius_mm={self.radius_mm:g}: the"
                " torus has no hole."
            )

    def signed_distance(self, points: Points) -> Distances:
        across, along = self._in_half_plane(points).T
        return np.hypot(across - self.radius_mm, along) - self.tube_mm

    def bounds(self) -> Corners:
        return self._box(self.radius_mm * self._disc() + self.tube_mm)

    def surface(self, segments: int = 48) -> TriangleSurface:
        sides = segments, segments // 2
        return torus(self.radius_mm, self.tube_mm, self.center_mm, self.axis, sides)


@dataclass(frozen=True)
class Cone(_Revolved):
    """Cone or frustum: `center_mm` at mid-height, base radius `radius_mm`, top radius `top_mm`."""

    radius_mm: Real = checked(positive, 1.0)
    height_mm: Real = checked(positive, 1.0)
    axis: Vector = checked(unit_vector, UP)
    top_mm: Real = checked(_top_radius, 0.0)

    def _profile(self) -> Profile:
        half = self.height_mm / 2
        corners = [(0.0, -half), (self.radius_mm, -half), (self.top_mm, half), (0.0, half)]
        return np.array(corners if self.top_mm > 0 else corners[:3])


@dataclass(frozen=True)
class Hemisphere(_Revolved):
    """Half a ball: `center_mm` of the flat side, `radius_mm`, `axis` toward the dome."""

    radius_mm: Real = checked(positive, 1.0)
    axis: Vector = checked(unit_vector, UP)

    def signed_distance(self, points: Points) -> Distances:
        across, along = self._in_half_plane(points).T
        to_ball = np.hypot(across, along) - self.radius_mm
        below = np.hypot(np.maximum(across - self.radius_mm, 0.0), along)
        return np.where(along < 0, below, np.maximum(to_ball, -along))

    def bounds(self) -> Corners:
        axis, radius, disc = np.array(self.axis), self.radius_mm, self.radius_mm * self._disc()
        # Directions into the dome's half-space reach the ball, the others the rim.
        low, high = np.where(axis < 0, radius, disc), np.where(axis > 0, radius, disc)
        return np.stack((np.array(self.center_mm) - low, np.array(self.center_mm) + high))

    def _profile(self) -> Profile:
        angles = np.linspace(0.0, np.pi / 2, _CURVE_SEGMENTS + 1)
        arc = self.radius_mm * np.column_stack((np.cos(angles), np.sin(angles)))
        arc[-1, 0] = 0.0
        return np.concatenate(([(0.0, 0.0)], arc))


@dataclass(frozen=True)
class Hyperboloid(_Revolved):
    """Hyperboloid of one sheet: radius `waist_mm` at mid-height, `rim_mm` at both ends.

    Its profile, radius^2 = waist^2 + (rim^2 - waist^2) (2 z / height)^2, is approximated by 96
    straight segments.
    """

    waist_mm: Real = checked(positive, 0.7)
    rim_mm: Real = checked(positive, 1.0)
    height_mm: Real = checked(positive, 2.0)
    axis: Vector = checked(unit_vector, UP)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.waist_mm > self.rim_mm:
            raise ConfigError(
                f"waist_mm={self.waist_mm:g} exceeds rim_mm={self.rim_mm:g}; a hyperboloid is"
                " narrowest at its waist."
            )

    def _profile(self) -> Profile:
        fraction = np.linspace(-1.0, 1.0, _CURVE_SEGMENTS + 1)
        radius = np.sqrt(self.waist_mm**2 + (self.rim_mm**2 - self.waist_mm**2) * fraction**2)
        curve = np.column_stack((radius, fraction * self.height_mm / 2))
        return np.concatenate(([(0.0, curve[0, 1])], curve, [(0.0, curve[-1, 1])]))


@dataclass(frozen=True)
class Lathe(_Revolved):
    """Solid of revolution of an arbitrary profile.

    Attributes:
        center_mm: Position of (0, 0) of the outline.
        outline_mm: Points (radius, height) from the lower end on the axis to the upper; only the
            ends have radius 0.
        axis: Direction of the axis.
    """

    outline_mm: Rows = checked(_outline, ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0)))
    axis: Vector = checked(unit_vector, UP)

    def _profile(self) -> Profile:
        return np.array(self.outline_mm)


def _polygon_distance(points: Float[np.ndarray, "n 2"], profile: Profile) -> Distances:
    """Signed distances in the half-plane to a profile closed by the axis."""
    nearest = np.full(len(points), np.inf)
    inside = np.zeros(len(points), dtype=bool)
    r, z = points.T.copy()  # contiguous, which is several times as fast
    for a, b in pairwise(profile):
        edge = b - a
        across, along = r - a[0], z - a[1]
        fraction = np.clip((across * edge[0] + along * edge[1]) / (edge @ edge), 0.0, 1.0)
        across -= fraction * edge[0]
        along -= fraction * edge[1]
        np.minimum(nearest, across * across + along * along, out=nearest)
        # A ray outward from the point crosses the outline an odd number of times from inside.
        crosses = (a[1] > z) != (b[1] > z)
        if crosses.any():
            crossing = a[0] + (z[crosses] - a[1]) / edge[1] * edge[0]
            inside[crosses] ^= r[crosses] < crossing
    return np.where(inside, -1.0, 1.0) * np.sqrt(nearest)

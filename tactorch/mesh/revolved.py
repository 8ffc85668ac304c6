"""Solids of revolution as signed distances. Lengths in mm.

The nearest point of the surface is in the same half-plane through the axis, so the distance to the
solid equals the distance to its profile in that half-plane and is exact.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.mesh.shapes import Solid
from tactorch.mesh.values import Real, Rows, Vector, checked, positive, unit_vector, vector

_CURVE_SEGMENTS = 96
Profile = Float[np.ndarray, "c 2"]


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


@runtime_checkable
class Axial(Protocol):
    """Shape around the line through `center_mm` along `axis`."""

    @property
    def center_mm(self) -> Vector: ...  # noqa: D102
    @property
    def axis(self) -> Vector: ...  # noqa: D102


@runtime_checkable
class Revolved(Axial, Protocol):
    """Solid of revolution with a profile."""

    def profile(self) -> Profile:
        """Return the outline as (radius, height) from the lower end of the axis to the upper."""
        ...


class _Revolved(Solid):
    """Signed distance and bounds from the profile."""

    def signed_distance(
        self: Revolved, points: Float[np.ndarray, "k 3"]
    ) -> Float[np.ndarray, " k"]:
        """Return the distance of each point to the surface, mm, negative inside."""
        return _polygon_distance(_in_half_plane(self, points), self.profile())

    def bounds(self: Revolved) -> Float[np.ndarray, "2 3"]:
        """Return the lowest and the highest corner of the bounding box, mm."""
        return _revolved_bounds(self.center_mm, self.axis, self.profile())


@dataclass(frozen=True)
class Torus(Solid):
    """Torus: `center_mm`, major radius `radius_mm`, minor radius `tube_mm`, `axis`."""

    center_mm: Vector = checked(vector, (0.0, 0.0, 0.0))
    radius_mm: Real = checked(positive, 1.0)
    tube_mm: Real = checked(positive, 0.3)
    axis: Vector = checked(unit_vector, (0.0, 0.0, 1.0))

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.tube_mm >= self.radius_mm:
            raise ConfigError(
                f"tube_mm={self.tube_mm:g} must be smaller than radius_mm={self.radius_mm:g}: the"
                " torus has no hole."
            )

    def signed_distance(self, points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        """Return the distance of each point to the surface, mm, negative inside."""
        across, along = _in_half_plane(self, points).T
        return np.hypot(across - self.radius_mm, along) - self.tube_mm

    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Return the lowest and the highest corner of the bounding box, mm."""
        flat = np.sqrt(np.maximum(0.0, 1.0 - np.array(self.axis) ** 2))
        half = self.radius_mm * flat + self.tube_mm
        return np.stack((np.array(self.center_mm) - half, np.array(self.center_mm) + half))


@dataclass(frozen=True)
class Cone(_Revolved):
    """Cone or frustum: `center_mm` at mid-height, base radius `radius_mm`, top radius `top_mm`."""

    center_mm: Vector = checked(vector, (0.0, 0.0, 0.0))
    radius_mm: Real = checked(positive, 1.0)
    height_mm: Real = checked(positive, 1.0)
    axis: Vector = checked(unit_vector, (0.0, 0.0, 1.0))
    top_mm: Real = checked(_top_radius, 0.0)

    def profile(self) -> Profile:
        """Return the outline as (radius, height) from the lower end of the axis to the upper."""
        half = self.height_mm / 2
        corners = [(0.0, -half), (self.radius_mm, -half), (self.top_mm, half), (0.0, half)]
        return np.array(corners if self.top_mm > 0 else corners[:3])


@dataclass(frozen=True)
class Hemisphere(_Revolved):
    """Half a ball: `center_mm` of the flat side, `radius_mm`, `axis` toward the dome."""

    center_mm: Vector = checked(vector, (0.0, 0.0, 0.0))
    radius_mm: Real = checked(positive, 1.0)
    axis: Vector = checked(unit_vector, (0.0, 0.0, 1.0))

    def profile(self) -> Profile:
        """Return the outline as (radius, height) from the lower end of the axis to the upper."""
        angles = np.linspace(0.0, np.pi / 2, _CURVE_SEGMENTS + 1)
        arc = self.radius_mm * np.column_stack((np.cos(angles), np.sin(angles)))
        arc[-1, 0] = 0.0
        return np.concatenate(([(0.0, 0.0)], arc))

    def signed_distance(self, points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        """Return the distance of each point to the surface, mm, negative inside."""
        across, along = _in_half_plane(self, points).T
        to_ball = np.hypot(across, along) - self.radius_mm
        below = np.hypot(np.maximum(across - self.radius_mm, 0.0), along)
        return np.where(along < 0, below, np.maximum(to_ball, -along))

    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Return the lowest and the highest corner of the bounding box, mm."""
        axis, center = np.array(self.axis), np.array(self.center_mm)
        disc = self.radius_mm * np.sqrt(np.maximum(0.0, 1.0 - axis**2))
        # Directions into the dome's half-space reach the ball, the others the rim.
        return np.stack(
            (
                center - np.where(axis < 0, self.radius_mm, disc),
                center + np.where(axis > 0, self.radius_mm, disc),
            )
        )


@dataclass(frozen=True)
class Hyperboloid(_Revolved):
    """Hyperboloid of one sheet: radius `waist_mm` at mid-height, `rim_mm` at both ends.

    Its profile, radius^2 = waist^2 + (rim^2 - waist^2) (2 z / height)^2, is approximated by 96
    straight segments.
    """

    center_mm: Vector = checked(vector, (0.0, 0.0, 0.0))
    waist_mm: Real = checked(positive, 0.7)
    rim_mm: Real = checked(positive, 1.0)
    height_mm: Real = checked(positive, 2.0)
    axis: Vector = checked(unit_vector, (0.0, 0.0, 1.0))

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.waist_mm > self.rim_mm:
            raise ConfigError(
                f"waist_mm={self.waist_mm:g} exceeds rim_mm={self.rim_mm:g}; a hyperboloid is"
                " narrowest at its waist."
            )

    def profile(self) -> Profile:
        """Return the outline as (radius, height) from the lower end of the axis to the upper."""
        share = np.linspace(-1.0, 1.0, _CURVE_SEGMENTS + 1)
        radius = np.sqrt(self.waist_mm**2 + (self.rim_mm**2 - self.waist_mm**2) * share**2)
        curve = np.column_stack((radius, share * self.height_mm / 2))
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

    center_mm: Vector = checked(vector, (0.0, 0.0, 0.0))
    outline_mm: Rows = checked(_outline, ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0)))
    axis: Vector = checked(unit_vector, (0.0, 0.0, 1.0))

    def profile(self) -> Profile:
        """Return the outline as (radius, height) from the lower end of the axis to the upper."""
        return np.array(self.outline_mm)


def _revolved_bounds(center: Vector, axis: Vector, profile: Profile) -> Float[np.ndarray, "2 3"]:
    """Return the bounding box of a profile revolved around an axis, mm."""
    along = np.outer(profile[:, 1], np.array(axis))
    across = np.outer(profile[:, 0], np.sqrt(np.maximum(0.0, 1.0 - np.array(axis) ** 2)))
    low, high = (along - across).min(axis=0), (along + across).max(axis=0)
    return np.array(center) + np.stack((low, high))


def _in_half_plane(shape: Axial, points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "k 2"]:
    """Return each point's distance from the axis and its height along it."""
    axis = np.array(shape.axis)
    offset = points - np.array(shape.center_mm)
    along = offset @ axis
    return np.column_stack((np.linalg.norm(offset - along[:, None] * axis, axis=1), along))


def _polygon_distance(
    points: Float[np.ndarray, "k 2"], profile: Profile
) -> Float[np.ndarray, " k"]:
    """Return signed distances in the half-plane to a profile closed by the axis."""
    nearest = np.full(len(points), np.inf)
    inside = np.zeros(len(points), dtype=bool)
    r, z = points.T.copy()  # contiguous, which is several times as fast
    for a, b in pairwise(profile):
        edge = b - a
        across, along = r - a[0], z - a[1]
        share = np.clip((across * edge[0] + along * edge[1]) / (edge @ edge), 0.0, 1.0)
        across -= share * edge[0]
        along -= share * edge[1]
        np.minimum(nearest, across * across + along * along, out=nearest)
        # A ray outward from the point crosses the outline an odd number of times from inside.
        crosses = (a[1] > z) != (b[1] > z)
        if crosses.any():
            crossing = a[0] + (z[crosses] - a[1]) / edge[1] * edge[0]
            inside[crosses] ^= r[crosses] < crossing
    return np.where(inside, -1.0, 1.0) * np.sqrt(nearest)

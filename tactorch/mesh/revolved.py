"""Solids of revolution as signed distances. Lengths in mm.

A point's nearest point on the surface lies in its own half-plane through the axis, so the distance
to the solid is that to its profile there: exact, as those of `shapes`.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from tactorch.errors import ConfigError
from tactorch.mesh.shapes import Contains, store
from tactorch.mesh.values import Real, Rows, Vector, positive, unit_vector, vector

_CURVE = 96  # pieces of a profile's curve
Profile = Float[np.ndarray, "c 2"]


@runtime_checkable
class Placed(Protocol):
    """What lies around the line through `center_mm` along `axis`."""

    @property
    def center_mm(self) -> Vector: ...  # noqa: D102
    @property
    def axis(self) -> Vector: ...  # noqa: D102


@runtime_checkable
class Revolved(Placed, Protocol):
    """A solid of revolution, given by its outline."""

    def profile(self) -> Profile:
        """Return the outline as (radius, height) from the lower end of the axis to the upper."""
        ...


class _Turned(Contains):
    """Distance and bounds of what has a profile."""

    def signed_distance(
        self: Revolved, points: Float[np.ndarray, "k 3"]
    ) -> Float[np.ndarray, " k"]:
        """Return the distance of each point to the surface, mm, negative inside."""
        return _polygon_distance(_in_half_plane(self, points), self.profile())

    def bounds(self: Revolved) -> Float[np.ndarray, "2 3"]:
        """Return the lowest and the highest corner of the bounding box, mm."""
        return turned_bounds(self.center_mm, self.axis, self.profile())


@dataclass(frozen=True)
class Torus(Contains):
    """A ring: `center_mm`, `radius_mm` of the ring's core, `tube_mm` around it, `axis`."""

    center_mm: Vector = (0.0, 0.0, 0.0)
    radius_mm: Real = 1.0
    tube_mm: Real = 0.3
    axis: Vector = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        _store_place(self, self.center_mm, self.axis)
        store(self, radius_mm=positive("radius_mm", self.radius_mm))
        store(self, tube_mm=positive("tube_mm", self.tube_mm))
        if self.tube_mm >= self.radius_mm:
            raise ConfigError(
                f"tube_mm={self.tube_mm:g} must be smaller than radius_mm={self.radius_mm:g}: the"
                " ring has no hole."
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
class Cone(_Turned):
    """A cone or its frustum: `center_mm` at mid-height, `radius_mm` below, `top_mm` above."""

    center_mm: Vector = (0.0, 0.0, 0.0)
    radius_mm: Real = 1.0
    height_mm: Real = 1.0
    axis: Vector = (0.0, 0.0, 1.0)
    top_mm: Real = 0.0

    def __post_init__(self) -> None:
        _store_place(self, self.center_mm, self.axis)
        store(self, radius_mm=positive("radius_mm", self.radius_mm))
        store(self, height_mm=positive("height_mm", self.height_mm))
        if not (np.isfinite(self.top_mm) and self.top_mm >= 0):
            raise ConfigError(f"top_mm={self.top_mm!r} must be a radius, or 0 for a point.")
        store(self, top_mm=float(self.top_mm))

    def profile(self) -> Profile:
        """Return the outline as (radius, height) from the lower end of the axis to the upper."""
        half = self.height_mm / 2
        corners = [(0.0, -half), (self.radius_mm, -half), (self.top_mm, half), (0.0, half)]
        return np.array(corners if self.top_mm > 0 else corners[:3])


@dataclass(frozen=True)
class Hemisphere(_Turned):
    """Half a ball: `center_mm` of its flat side, `radius_mm`, `axis` toward the dome."""

    center_mm: Vector = (0.0, 0.0, 0.0)
    radius_mm: Real = 1.0
    axis: Vector = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        _store_place(self, self.center_mm, self.axis)
        store(self, radius_mm=positive("radius_mm", self.radius_mm))

    def profile(self) -> Profile:
        """Return the outline as (radius, height) from the lower end of the axis to the upper."""
        angles = np.linspace(0.0, np.pi / 2, _CURVE + 1)
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
        # Each axis that points into the dome's half reaches the ball, the others the rim.
        return np.stack(
            (
                center - np.where(axis < 0, self.radius_mm, disc),
                center + np.where(axis > 0, self.radius_mm, disc),
            )
        )


@dataclass(frozen=True)
class Hyperboloid(_Turned):
    """A waisted cylinder, of one sheet: radius `waist_mm` at mid-height, `rim_mm` at both ends.

    Its curve, radius^2 = waist^2 + (rim^2 - waist^2) (2 z / height)^2, is taken in 96 straight
    pieces.
    """

    center_mm: Vector = (0.0, 0.0, 0.0)
    waist_mm: Real = 0.7
    rim_mm: Real = 1.0
    height_mm: Real = 2.0
    axis: Vector = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        _store_place(self, self.center_mm, self.axis)
        for name in ("waist_mm", "rim_mm", "height_mm"):
            store(self, **{name: positive(name, getattr(self, name))})
        if self.waist_mm > self.rim_mm:
            raise ConfigError(
                f"waist_mm={self.waist_mm:g} exceeds rim_mm={self.rim_mm:g}; a hyperboloid is"
                " narrowest at its waist."
            )

    def profile(self) -> Profile:
        """Return the outline as (radius, height) from the lower end of the axis to the upper."""
        share = np.linspace(-1.0, 1.0, _CURVE + 1)
        radius = np.sqrt(self.waist_mm**2 + (self.rim_mm**2 - self.waist_mm**2) * share**2)
        curve = np.column_stack((radius, share * self.height_mm / 2))
        return np.concatenate(([(0.0, curve[0, 1])], curve, [(0.0, curve[-1, 1])]))


@dataclass(frozen=True)
class Lathe(_Turned):
    """A solid of revolution of any outline.

    Attributes:
        center_mm: What (0, 0) of the outline stands for.
        outline_mm: Points (radius, height) from one end on the axis to the other, upward; only
            the ends have radius 0.
        axis: Direction of the axis.
    """

    center_mm: Vector = (0.0, 0.0, 0.0)
    outline_mm: Rows = ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))
    axis: Vector = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        _store_place(self, self.center_mm, self.axis)
        points = np.asarray(self.outline_mm, dtype=np.float64)
        if points.ndim != 2 or points.shape[1:] != (2,) or not np.isfinite(points).all():
            raise ConfigError("outline_mm must be points (radius, height), finite, in mm.")
        if len(points) < 3 or points[[0, -1], 0].any() or not (points[1:-1, 0] > 0).all():
            raise ConfigError(
                "outline_mm must begin and end on the axis (radius 0) and be off it between."
            )
        if not np.diff(points, axis=0).any(axis=1).all():
            raise ConfigError("outline_mm repeats a point; leave one out.")
        store(self, outline_mm=tuple(tuple(map(float, point)) for point in points))

    def profile(self) -> Profile:
        """Return the outline as (radius, height) from the lower end of the axis to the upper."""
        return np.array(self.outline_mm)


def turned_bounds(center: Vector, axis: Vector, profile: Profile) -> Float[np.ndarray, "2 3"]:
    """Return the bounding box of a profile turned around an axis, mm."""
    along = np.outer(profile[:, 1], np.array(axis))
    across = np.outer(profile[:, 0], np.sqrt(np.maximum(0.0, 1.0 - np.array(axis) ** 2)))
    low, high = (along - across).min(axis=0), (along + across).max(axis=0)
    return np.array(center) + np.stack((low, high))


def _in_half_plane(shape: Placed, points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "k 2"]:
    """Return each point's distance from the axis and its height along it."""
    axis = np.array(shape.axis)
    offset = points - np.array(shape.center_mm)
    along = offset @ axis
    return np.column_stack((np.linalg.norm(offset - along[:, None] * axis, axis=1), along))


def _polygon_distance(
    points: Float[np.ndarray, "k 2"], profile: Profile
) -> Float[np.ndarray, " k"]:
    """Return signed distances in the half-plane to a profile that the axis closes."""
    nearest = np.full(len(points), np.inf)
    inside = np.zeros(len(points), dtype=bool)
    r, z = points.T.copy()  # each in one piece, which is several times as fast
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
            at = a[0] + (z[crosses] - a[1]) / edge[1] * edge[0]
            inside[crosses] ^= r[crosses] < at
    return np.where(inside, -1.0, 1.0) * np.sqrt(nearest)


def _store_place(shape: object, center: Vector, axis: Vector) -> None:
    store(shape, center_mm=vector("center_mm", center), axis=unit_vector("axis", axis))

"""An inclusion as numbers and as a body."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from tactorch.mesh import Shape, Sphere
from tactorch.mesh.surfaces import TriangleSurface

_PER_RADIUS = 6  # points of a cloud, for a ball along its radius
_MIN_VARIANCE = 1e-4  # mm2, of a cloud along a principal axis


class Parameters(NamedTuple):
    """Parameters of an inclusion, or of each of several draws of it."""

    center: Float[np.ndarray, "*draws 3"]  # mm
    log_radius: Float[np.ndarray, " *draws"]  # log mm, of the ball of the same volume
    log_contrast: Float[np.ndarray, " *draws"]  # of Young's modulus over that of the background
    distortions: Float[np.ndarray, "*draws k"]  # parameters of the family beside them

    @staticmethod
    def of(values: Float[np.ndarray, "*draws parameters"]) -> "Parameters":
        """Return parameters in the order of `COMMON`, with distortions after them."""
        return Parameters(values[..., :3], values[..., 3], values[..., 4], values[..., 5:])


#: Names of the parameters that all inclusions have, in their order.
CENTER = ("x", "y", "z")
SIZE = ("log_radius", "log_contrast")
COMMON = (*CENTER, *SIZE)


class Candidate(NamedTuple):
    """A ball or a rod that would reduce the misfit."""

    center_mm: Float[np.ndarray, "3"]
    radius_mm: float
    log_contrast: float
    gain: float  # reduction of half the sum of squared residuals, linearised
    half_mm: Float[np.ndarray, "3"]  # from the centre to an end of a rod; zero for a ball


class Cloud(NamedTuple):
    """Points inside one or several inclusions, as which others may be tried."""

    points: Float[np.ndarray, "n 3"]  # mm
    log_radius: float  # log mm, of the ball of the same volume
    log_contrast: float

    @staticmethod
    def of(shapes: "Sequence[InclusionShape]") -> "Cloud":
        """Return the points of a lattice inside inclusions, of their volume and mean contrast."""
        volumes = np.array([shape.radius_mm**3 for shape in shapes])
        centers = np.array([shape.center_mm for shape in shapes])
        halves = np.array([shape.half_size_mm for shape in shapes])
        low, high = (centers - halves).min(axis=0), (centers + halves).max(axis=0)
        spacing = np.cbrt(volumes.sum()) / _PER_RADIUS
        ticks = [np.arange(a, b, spacing) + 0.5 * spacing for a, b in zip(low, high, strict=True)]
        lattice = np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1).reshape(-1, 3)
        inside = np.any([shape.contains(lattice) for shape in shapes], axis=0)
        logs = np.log([shape.contrast for shape in shapes])
        points = lattice[inside] if inside.any() else centers
        log_contrast = float(np.average(logs, weights=volumes))
        return Cloud(points, float(np.log(volumes.sum()) / 3.0), log_contrast)

    @property
    def center(self) -> Float[np.ndarray, "3"]:
        """Mean of the points, mm."""
        return self.points.mean(axis=0)

    def principal(self) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
        """Return the standard deviations (mm) along the principal axes, and these, the rows.

        They are in descending order, and the axes are a rotation.
        """
        offsets = self.points - self.center
        squares, axes = np.linalg.eigh(offsets.T @ offsets / len(offsets))
        axes = axes.T[::-1] * np.linalg.det(axes.T[::-1])
        return np.sqrt(np.maximum(squares[::-1], _MIN_VARIANCE)), axes

    def halves(self) -> "tuple[Cloud, Cloud]":
        """Return the points on either side of the centre along the first principal axis."""
        along = (self.points - self.center) @ self.principal()[1][0]
        log_radius = self.log_radius - np.log(2.0) / 3.0
        first, last = (
            self._replace(points=self.points[side], log_radius=log_radius)
            for side in (along <= 0.0, along >= 0.0)
        )
        return first, last


@dataclass(frozen=True)
class InclusionShape:
    """An ellipsoid of one contrast, and the base of bodies that are other shapes when stretched.

    Attributes:
        center_mm: Centre.
        semi_axes_mm: Half its lengths along its axes in descending order; equal for a ball.
        axes: Their directions, the rows of a rotation.
        contrast: Young's modulus over that of the background.
    """

    center_mm: tuple[float, float, float]
    semi_axes_mm: tuple[float, float, float]
    axes: tuple[tuple[float, float, float], ...]
    contrast: float

    #: The shape of semi-axes of one, and its volume over that of the unit ball.
    unit: ClassVar[Shape] = Sphere()
    unit_volume: ClassVar[float] = 1.0

    @property
    def form(self) -> str:
        """Noun for the form."""
        return "lump"

    def contains(self, points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Return whether points (mm) are inside."""
        return self.distance(points) <= 0.0

    def distance(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Return the distance to the boundary (mm), negative inside; exact for balls only."""
        return self.unit.signed_distance(self.relative(points)) * self.radius_mm

    def relative(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Return points (mm) along the axes, over the semi-axes."""
        return (points - self.center_mm) @ np.array(self.axes).T / np.array(self.semi_axes_mm)

    @property
    def radius_mm(self) -> float:
        """Radius of the ball of the same volume."""
        return float(np.cbrt(self.unit_volume * np.prod(self.semi_axes_mm)))

    @property
    def centroid_mm(self) -> Float[np.ndarray, "3"]:
        """Centre of volume, mm."""
        return np.array(self.center_mm)

    @property
    def detail_mm(self) -> float:
        """Length within which strains change near the boundary."""
        return self.radius_mm

    @cached_property
    def vectors(self) -> Float[np.ndarray, "3 3"]:
        """Vectors from the centre to the ends of the semi-axes, the rows, mm."""
        return np.array(self.semi_axes_mm)[:, None] * np.array(self.axes)

    @property
    def extents_mm(self) -> Float[np.ndarray, "2 3"]:
        """Lowest and highest coordinates, from the centre."""
        return np.outer([-1.0, 1.0], np.linalg.norm(self.vectors, axis=0))

    @property
    def half_size_mm(self) -> Float[np.ndarray, "3"]:
        """Largest distance of its points from the centre along x, y and z."""
        return np.asarray(np.abs(self.extents_mm).max(axis=0))

    @property
    def size_mm(self) -> Float[np.ndarray, "3"]:
        """Size along x, y and z."""
        return np.asarray(np.ptp(self.extents_mm, axis=0))

    def surface(self, segments: int = 48) -> TriangleSurface:
        """Return vertices (mm) and outward triangles; see `tactorch.mesh.Shape.surface`."""
        vertices, triangles = self.unit.surface(segments)
        return vertices @ self.vectors + self.center_mm, triangles

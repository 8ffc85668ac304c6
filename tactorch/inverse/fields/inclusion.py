"""An inclusion as numbers and as a body."""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from tactorch.mesh import Shape, Sphere
from tactorch.mesh.surfaces import TriangleSurface


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

    def contains(self, points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Return whether points (mm) are inside."""
        return self.unit.signed_distance(self.relative(points)) <= 0.0

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

    @cached_property
    def vectors(self) -> Float[np.ndarray, "3 3"]:
        """Vectors from the centre to the ends of the semi-axes, the rows, mm."""
        return np.array(self.semi_axes_mm)[:, None] * np.array(self.axes)

    @property
    def half_size_mm(self) -> Float[np.ndarray, "3"]:
        """Half the size along x, y and z."""
        return np.linalg.norm(self.vectors, axis=0)

    def surface(self, segments: int = 48) -> TriangleSurface:
        """Return vertices (mm) and outward triangles; see `tactorch.mesh.Shape.surface`."""
        vertices, triangles = self.unit.surface(segments)
        return vertices @ self.vectors + self.center_mm, triangles
